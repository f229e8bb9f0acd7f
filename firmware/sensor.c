#include "sensor.h"

enum {
    MOST_EDGES = 250,       /* in 10 ms: ten times what a wheel's teeth give at top speed */
    MOST_SLEEVE_UM = 20000, /* the range of the wire */
    MESSAGES = HAL_CHANNELS + 3
};

static struct edge_channel channels[HAL_CHANNELS];
static uint16_t collected[HAL_CHANNELS]; /* edges since the last cycle */
static uint32_t read_us;                 /* of the present cycle */
static uint8_t counters[MESSAGES];

void sensor_power_on(void) {
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        edges_power_on(&channels[i], hal_sensor_us());
        collected[i] = 0;
    }
    for (unsigned i = 0; i < MESSAGES; i++) {
        counters[i] = 0;
    }
}

static void collect_to(uint32_t now_us) {
    uint32_t stamp_us;
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        /* Noise may come faster than it is taken: what is too much waits, and the rest goes on. */
        while (collected[i] <= MOST_EDGES && hal_next_edge(i, now_us, &stamp_us)) {
            edges_capture(&channels[i], stamp_us);
            collected[i]++;
        }
        edges_watch(&channels[i], now_us);
    }
}

void sensor_collect(void) {
    collect_to(hal_sensor_us());
}

/* A wheel that has no good signal says so, and the others go on. */
static void send_edges(void) {
    struct frame frame;
    struct edge_read read;
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        edges_read(&channels[i], read_us, &read);
        read.sensor_fault = hal_wheel_is_bad(i / 2) || collected[i] > MOST_EDGES;
        collected[i] = 0;
        frames_put_edges(&frame, i, &read);
        frames_send(&frame, &counters[i]);
    }
}

/* Brings one sleeve's samples into range; 1 where one of them is of no use. */
static unsigned judge_sleeve(struct hal_scan scans[HAL_SCANS], unsigned sleeve) {
    unsigned is_bad = 0;
    for (unsigned i = 0; i < HAL_SCANS; i++) {
        int16_t *um = &scans[i].sleeve_um[sleeve];
        is_bad |= (unsigned)scans[i].bad_sleeves >> sleeve & 1;
        if (*um < -MOST_SLEEVE_UM || *um > MOST_SLEEVE_UM) {
            *um = *um < 0 ? -MOST_SLEEVE_UM : MOST_SLEEVE_UM;
            is_bad = 1;
        }
    }
    return is_bad;
}

void sensor_cycle(const struct hal_scan scans[HAL_SCANS]) {
    struct frame frame;
    hal_lock(); /* nothing comes between a pulse and its time */
    if (hal_is_all_sent()) { /* else a late frame would be taken for that of this pulse */
        hal_sync_pulse();
    }
    read_us = hal_sensor_us(); /* all wheels are read at the same microsecond */
    hal_unlock();
    collect_to(read_us);
    send_edges();
    frames_put_gearbox_sensors(&frame, read_us, &scans[0]);
    frames_send(&frame, &counters[HAL_CHANNELS]);
}

void sensor_send_sleeves(struct hal_scan scans[HAL_SCANS]) {
    struct frame frame;
    for (unsigned first = 0; first < HAL_SLEEVES; first += 2) {
        unsigned faults = judge_sleeve(scans, first) | judge_sleeve(scans, first + 1) << 1;
        frames_put_sleeves(&frame, read_us, scans, first, (uint8_t)faults);
        frames_send(&frame, &counters[HAL_CHANNELS + 1 + first / 2]);
    }
}
