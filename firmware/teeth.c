#include "teeth.h"

#include "board.h"
#include "e2e.h"
#include "frames.h"

enum {
    DELAY_US = 30000, /* 10 ms to the next read, 10 more where a frame is lost, 10 for the bus */
    LEAST_AHEAD_US = 5,
    MOST_AHEAD_US = 100000, /* an edge is shown within these two */
    STEP_US = 4000,         /* in each the rig's clock is followed by 1 us: 250 ppm */
    SECOND = 250,           /* steps */
    JUMP_US = 20000,        /* a clock that is further off is another one */
    RAMP = 500,             /* the run-up, in steps: 2 s up, 6 s at the top, 2 s down */
    RUN = 2500,
    EDGE = SECOND * RAMP,
    RING = 256
};

/* Edges a second at the top, 1,110 rpm in gear 12 of truck12: 40, 43 x 35/37, 45 and 42 teeth. */
static const uint16_t TOP[HAL_WHEELS] = {1480, 1505, 1665, 1554};

/* Of a wheel its rising edges, or the falling ones. */
struct track {
    struct e2e_channel e2e;
    uint16_t newest; /* index of the last edge reported */
    uint8_t in;      /* the ring of those that are not shown yet */
    uint8_t out;
    uint32_t edges_us[RING]; /* in the rig's clock */
};

struct pin {
    bool is_high;
    bool is_armed;
};

/* The rig's clock: the own one at a frame's arrival less the rig's at its read. */
struct rig_clock {
    bool is_known;
    uint32_t offset_us;
    int32_t rest_us;     /* by which it is yet to be changed */
    int32_t earliest_us; /* by which the earliest frame of this second came later */
};

uint32_t teeth_reported;
uint32_t teeth_shown;
static struct track tracks[HAL_CHANNELS];
static struct pin pins[HAL_WHEELS];
static struct rig_clock rig = {.earliest_us = INT32_MAX};
static uint32_t step_us; /* time of the last step */
static uint32_t steps;
static uint32_t run;    /* where the run-up is, in steps */
static uint32_t turned; /* and how far the shafts have turned in it */

static void put(struct track *track, uint32_t edge_us) {
    track->edges_us[track->in] = edge_us;
    track->in++;
}

/* A pin that is low waits for a rising edge: those of a track come in order, so none that is yet
 * to be heard is earlier. Falling edges passed over meanwhile are late when it is their turn. */
static void arm(unsigned wheel) {
    struct pin *pin = &pins[wheel];
    struct track *next = &tracks[2 * wheel + pin->is_high];
    while (!pin->is_armed && next->out != next->in) {
        uint32_t at_us = next->edges_us[next->out] + rig.offset_us + DELAY_US;
        next->out++;
        if (at_us - hal_sensor_us() - LEAST_AHEAD_US < MOST_AHEAD_US) {
            pin->is_armed = true;
            hal_toggle_at(wheel, at_us);
        }
    }
}

void board_on_toggled(unsigned wheel) {
    teeth_shown++;
    pins[wheel].is_high = !pins[wheel].is_high;
    pins[wheel].is_armed = false;
    arm(wheel);
}

/* A whole frame of this track. */
static void hear(struct track *track, const struct edge_read *read, uint32_t now_us) {
    unsigned fresh = (uint16_t)(read->newest_index - track->newest);
    int32_t late_us = (int32_t)(now_us - read->read_us - rig.offset_us);
    track->newest = read->newest_index;
    teeth_reported += fresh;
    rig.earliest_us = late_us < rig.earliest_us ? late_us : rig.earliest_us;
    if (!rig.is_known || track->e2e.state != E2E_VALID) { /* 16 bits place what is new in a row */
        return;
    }
    for (unsigned i = fresh < read->valid_stamps ? fresh : read->valid_stamps; i > 0; i--) {
        put(track, read->read_us - (uint16_t)(read->read_us - read->stamps_us[i - 1]));
    }
}

void teeth_on_frame(const struct frame *frame) {
    unsigned number = (frame->id - ID_EDGES) / ID_EDGES_STEP % HAL_CHANNELS;
    uint32_t id = ID_EDGES + number * ID_EDGES_STEP;
    struct track *track = &tracks[number];
    struct edge_read read;
    uint32_t now_us = hal_sensor_us();
    if (frame->id != id) {
        return;
    }
    e2e_watch(&track->e2e, now_us);
    enum e2e_status status = frames_check(&track->e2e, frame, id, LENGTH_EDGES);
    (void)e2e_update(&track->e2e, status, now_us);
    if (status == E2E_OK && frames_get_edges(frame, &read)) {
        hear(track, &read, now_us);
        arm(number / 2);
    }
}

static void run_up(void) {
    run = rig.is_known ? 0 : (run + 1) % RUN;
    uint32_t speed = run < RUN - run ? run : RUN - run;
    speed = speed < RAMP ? speed : RAMP;
    for (unsigned i = 0; i < HAL_WHEELS; i++) {
        uint32_t until = TOP[i] * (turned + speed);
        for (uint32_t edge = TOP[i] * turned / EDGE + 1; edge <= until / EDGE; edge++) {
            put(&tracks[2 * i + (edge + 1) % 2],
                step_us - (until - edge * EDGE) * STEP_US / (TOP[i] * speed));
        }
        arm(i);
    }
    turned = run == 0 ? 0 : turned + speed;
}

/* Each second: is there a rig, and by how much has its clock gone on? The run-up's is the own. */
static void find_clock(void) {
    bool was_known = rig.is_known;
    rig.is_known = rig.earliest_us != INT32_MAX;
    rig.rest_us = rig.is_known ? rig.earliest_us : (int32_t)(UINT32_MAX - rig.offset_us + 1);
    rig.earliest_us = INT32_MAX;
    if (rig.is_known == was_known && rig.rest_us >= -JUMP_US && rig.rest_us <= JUMP_US) {
        return;
    }
    rig.offset_us += (uint32_t)rig.rest_us;
    rig.rest_us = 0;
    teeth_reported = 0;
    teeth_shown = 0;
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        tracks[i].out = tracks[i].in; /* by the clock before */
    }
}

static void follow_clock(void) {
    if (rig.rest_us > 0) {
        rig.offset_us++;
        rig.rest_us--;
    } else if (rig.rest_us < 0) {
        rig.offset_us--;
        rig.rest_us++;
    }
}

void teeth_poll(void) {
    hal_lock();
    uint32_t since_us = hal_sensor_us() - step_us;
    if (since_us >= STEP_US) {
        step_us += steps == 0 ? since_us : STEP_US;
        steps++;
        if (steps % SECOND == 0) {
            find_clock();
        }
        follow_clock();
        run_up();
    }
    hal_unlock();
}
