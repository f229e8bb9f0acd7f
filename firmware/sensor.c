#include "sensor.h"

enum {
    MOST_EDGES = 108,       /* in 10 ms: four times what a frame holds */
    MOST_SLEEVE_UM = 20000, /* the range of the wire */
    LATE_US = 10000         /* further ahead an edge is none of this clock's: it was set back */
};

static struct edge_channel channels[HAL_CHANNELS];
static uint16_t collected[HAL_CHANNELS]; /* edges since the last cycle */
static uint32_t read_us;                 /* of the present cycle */
static uint32_t collected_us;            /* no edge that was taken is later */
static struct edge_read reads[HAL_CHANNELS];

void sensor_power_on(void) {
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        edges_power_on(&channels[i], hal_sensor_us());
        collected[i] = 0;
    }
    collected_us = hal_sensor_us() - LATE_US;
}

static void collect_to(uint32_t now_us) {
    uint32_t stamp_us;
    collected_us = now_us;
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
static void read_edges(void) {
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        edges_read(&channels[i], read_us, &reads[i]);
        reads[i].sensor_fault = hal_wheel_is_bad(i / 2) || collected[i] > MOST_EDGES;
        collected[i] = 0;
    }
}

/* A receiver refuses a frame with a value outside the DBC's range: what is beyond is at its end. */
static uint16_t within(uint16_t value, uint16_t least, uint16_t most) {
    return value < least ? least : value > most ? most : value;
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

void sensor_cycle(struct hal_scan scans[HAL_SCANS], uint32_t sampled_us) {
    hal_lock(); /* nothing comes between a pulse and its time */
    if (hal_is_all_sent()) { /* else a late frame would be taken for that of this pulse */
        hal_sync_pulse();
    }
    uint32_t now_us = hal_sensor_us();
    hal_unlock();
    /* All wheels are read at one microsecond, that of the sleeves unless edges were taken since. */
    read_us = collected_us - sampled_us < LATE_US ? collected_us : sampled_us;
    collect_to(read_us);
    read_edges();
    scans[0].oil_centidegree = within(scans[0].oil_centidegree, 4000, 30000);
    scans[0].clutch_basispoint = within(scans[0].clutch_basispoint, 0, 10000);
    hal_watchdog(); /* what comes takes as long again */
    frames_send_reads(reads, now_us, &scans[0]);
}

void sensor_send_sleeves(struct hal_scan scans[HAL_SCANS]) {
    unsigned faults = 0;
    for (unsigned i = 0; i < HAL_SLEEVES; i++) {
        faults |= judge_sleeve(scans, i) << i;
    }
    frames_send_sleeves(read_us, scans, faults);
}
