#include "teeth.h"

#include "board.h"
#include "e2e.h"
#include "frames.h"

enum {
    DELAY_US = 30000, /* 10 ms to the next read, 10 more where a frame is lost, 10 for the bus */
    LEAST_AHEAD_US = 5, MOST_AHEAD_US = 100000, /* of an edge; what is not within is not shown */
    STEP_US = 4000, SECOND = 250, /* steps; in each the rig's clock is followed by 1 us, 250 ppm */
    JUMP_US = 20000,              /* a clock that is further off is another one */
    RAMP = 500, RUN = 2500,       /* the run-up, in steps: 2 s up, 6 s at the top, 2 s down */
    EDGE = SECOND * RAMP
};
/* Edges a second at the top, 1,110 rpm in gear 12 of truck12: 40, 43 x 35/37, 45 and 42 teeth. */
static const uint16_t TOP[HAL_WHEELS] = {1480, 1505, 1665, 1554};

static struct channel {
    struct e2e_channel e2e;
    uint16_t newest;        /* index of the last edge told of */
    uint8_t in, out;        /* of the ring: */
    uint32_t edges_us[256]; /* in the rig's clock */
} channels[HAL_CHANNELS];
static bool is_high[HAL_WHEELS], is_armed[HAL_WHEELS]; /* pins */
static bool is_rig; /* one is played */
/* Own clock at a frame's arrival less the rig's at its read; by how much that is yet to be changed,
 * and by how much the earliest frame of this second came later. */
static uint32_t offset_us;
static int32_t rest_us, earliest_us = INT32_MAX;
static uint32_t step_us, steps, run, turned;
uint32_t teeth_told, teeth_shown; /* edges since the rig was found, for a debugger */

/* A pin that is low waits for a rising edge: those of a channel come in order, so none that is yet
 * to be heard is earlier. Falling edges passed over meanwhile are late when it is their turn. */
static void arm(unsigned wheel) {
    struct channel *next = &channels[2 * wheel + is_high[wheel]];
    while (!is_armed[wheel] && next->out != next->in) {
        uint32_t at_us = next->edges_us[next->out++] + offset_us + DELAY_US;
        if (at_us - hal_sensor_us() - LEAST_AHEAD_US < MOST_AHEAD_US) {
            is_armed[wheel] = true;
            hal_toggle_at(wheel, at_us);
        }
    }
}

void board_on_toggled(unsigned wheel) {
    teeth_shown++;
    is_high[wheel] = !is_high[wheel];
    is_armed[wheel] = false;
    arm(wheel);
}

void teeth_on_frame(const struct frame *frame) {
    unsigned number = (frame->id - ID_EDGES) / ID_EDGES_STEP % HAL_CHANNELS;
    struct channel *channel = &channels[number];
    uint32_t now_us = hal_sensor_us();
    struct edge_read read;
    if (!frames_get_edges(frame, number, &read)) {
        return;
    }
    e2e_watch(&channel->e2e, now_us);
    enum e2e_status status =
        e2e_check(&channel->e2e, frame->data, frame->length, frames_data_id(frame->id));
    e2e_update(&channel->e2e, status, now_us);
    if (status != E2E_OK) {
        return;
    }
    unsigned fresh = (uint16_t)(read.newest_index - channel->newest);
    int32_t late_us = (int32_t)(now_us - read.read_us - offset_us);
    channel->newest = read.newest_index;
    teeth_told += fresh;
    earliest_us = late_us < earliest_us ? late_us : earliest_us;
    if (is_rig && channel->e2e.state == E2E_VALID) { /* then 16 bits place what is new */
        for (unsigned i = fresh < read.valid_stamps ? fresh : read.valid_stamps; i-- > 0;) {
            channel->edges_us[channel->in++] =
                read.read_us - (uint16_t)(read.read_us - read.stamps_us[i]);
        }
        arm(number / 2);
    }
}

static void run_up(void) {
    run = is_rig ? 0 : (run + 1) % RUN;
    uint32_t speed = run < RUN - run ? run : RUN - run;
    speed = speed < RAMP ? speed : RAMP;
    for (unsigned i = 0; i < HAL_WHEELS; i++) {
        uint32_t until = TOP[i] * (turned + speed);
        for (uint32_t edge = TOP[i] * turned / EDGE + 1; edge <= until / EDGE; edge++) {
            struct channel *channel = &channels[2 * i + (edge + 1) % 2];
            channel->edges_us[channel->in++] =
                step_us - (until - edge * EDGE) * STEP_US / (TOP[i] * speed);
        }
        arm(i);
    }
    turned = run == 0 ? 0 : turned + speed;
}

void teeth_poll(void) {
    hal_lock();
    uint32_t since_us = hal_sensor_us() - step_us;
    if (since_us >= STEP_US) {
        step_us += steps == 0 ? since_us : STEP_US;
        if (++steps % SECOND == 0) {
            bool was_rig = is_rig;
            is_rig = earliest_us != INT32_MAX; /* the run-up's clock is the own one */
            rest_us = is_rig ? earliest_us : (int32_t)(0 - offset_us);
            earliest_us = INT32_MAX;
            if (is_rig != was_rig || rest_us < -JUMP_US || rest_us > JUMP_US) {
                offset_us += (uint32_t)rest_us;
                rest_us = 0;
                teeth_told = teeth_shown = 0;
                for (unsigned i = 0; i < HAL_CHANNELS; i++) {
                    channels[i].out = channels[i].in; /* by the clock before */
                }
            }
        }
        int32_t by_us = (rest_us > 0) - (rest_us < 0);
        offset_us += (uint32_t)by_us;
        rest_us -= by_us;
        run_up();
    }
    hal_unlock();
}
