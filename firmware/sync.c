#include "sync.h"

#include "e2e.h"
#include "frames.h"

enum {
    FOLLOWS = !IMAGE_SENSOR, /* a board that has sensors has the clock */
    PAIRS_TO_KNOW = 3,       /* of pulse and frame, one after another, that agree */
    MOST_STEP_US = 50,       /* from one to the next: 200 ppm make 10 in LOST_US */
    LOST_US = 50000,         /* without a pair, as E2E has it without a frame */
    MOST_PULSES = 256        /* at once: noise may come faster than it is taken */
};

struct sync {
    struct e2e_channel channel;
    unsigned pairs;     /* in a row */
    uint32_t paired_us; /* own time of the last one */
    bool has_pulse;     /* one waits for its frame: */
    uint32_t pulse_us;
};

static struct sync sync;

void sync_power_on(void) {
    static const struct sync UNKNOWN;
    sync = UNKNOWN;
}

void sync_run(uint32_t own_us) {
    uint32_t stamp_us;
    for (unsigned i = 0; FOLLOWS && i < MOST_PULSES; i++) {
        if (!hal_next_edge(0, hal_sensor_us(), &stamp_us)) {
            break;
        }
        sync.pulse_us = stamp_us; /* an older one was without a frame */
        sync.has_pulse = true;
    }
    if (own_us - sync.paired_us >= LOST_US) {
        sync.pairs = 0;
    }
}

/* A read of the other board at this time of its clock. */
static void pair(uint32_t read_us) {
    int32_t step_us = (int32_t)(read_us - sync.pulse_us);
    bool agrees = step_us >= -MOST_STEP_US && step_us <= MOST_STEP_US;
    bool is_older = sync_is_known() && !agrees && step_us < 0 && step_us > -LOST_US;
    if (!sync.has_pulse || is_older) { /* a frame without its pulse; a pulse that is noise */
        return;
    }
    sync.pairs = agrees ? sync.pairs + (sync.pairs < PAIRS_TO_KNOW) : 1; /* 1: it has jumped */
    sync.paired_us = hal_own_us();
    sync.has_pulse = false;
    hal_shift_sensor(step_us);
}

void sync_on_frame(const struct frame *frame) {
    enum e2e_status status =
        frames_check(&sync.channel, frame, ID_GEARBOX_SENSORS, LENGTH_GEARBOX_SENSORS);
    if (e2e_update(&sync.channel, status, hal_own_us())) {
        pair(frames_get_time(frame));
    }
}

bool sync_is_known(void) {
    return !FOLLOWS || sync.pairs >= PAIRS_TO_KNOW;
}
