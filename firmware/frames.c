#include "frames.h"

enum { AT_TIME = 3, AT_CONTENT = 7 };

static void put16(uint8_t *to, uint16_t value) {
    to[0] = (uint8_t)(value & 0xFF);
    to[1] = (uint8_t)(value >> 8);
}

static void put32(uint8_t *to, uint32_t value) {
    put16(to, (uint16_t)(value & 0xFFFF));
    put16(to + 2, (uint16_t)(value >> 16));
}

static uint32_t get32(const uint8_t *from) {
    return (uint32_t)from[0] | (uint32_t)from[1] << 8 | (uint32_t)from[2] << 16 |
           (uint32_t)from[3] << 24;
}

uint16_t frames_data_id(uint32_t id) {
    return (uint16_t)(0x4D00 | (id >> 8 & 0xFF));
}

enum e2e_status frames_check(struct e2e_channel *channel, const struct frame *frame, uint32_t id,
                             unsigned length) {
    if (!frame->is_extended || !frame->is_fd || frame->id != id || frame->length != length) {
        return E2E_ERROR;
    }
    return e2e_check(channel, frame->data, length, frames_data_id(id));
}

/* An empty frame with its time, which all messages of ours have in the same place. */
static void begin(struct frame *frame, uint32_t id, uint8_t length, uint32_t time_us) {
    frame->id = id;
    frame->length = length;
    frame->is_extended = true;
    frame->is_fd = true;
    for (unsigned i = 0; i < sizeof frame->data; i++) {
        frame->data[i] = 0;
    }
    put32(frame->data + AT_TIME, time_us);
}

void frames_put_edges(struct frame *frame, unsigned channel, const struct edge_read *read) {
    begin(frame, ID_EDGES + channel * ID_EDGES_STEP, LENGTH_EDGES, read->read_us);
    put16(frame->data + AT_CONTENT, read->newest_index);
    frame->data[9] = (uint8_t)(read->valid_stamps | read->long_interval << 5 | read->stopped << 6 |
                               read->sensor_fault << 7);
    for (unsigned i = 0; i < EDGE_STAMPS; i++) {
        put16(frame->data + 10 + 2 * i, read->stamps_us[i]);
    }
}

/* A receiver refuses a frame with a value outside the DBC's range: what is beyond is at its end. */
static uint16_t within(uint16_t value, uint16_t least, uint16_t most) {
    return value < least ? least : value > most ? most : value;
}

void frames_put_gearbox_sensors(struct frame *frame, uint32_t sample_us,
                                const struct hal_scan *scan) {
    begin(frame, ID_GEARBOX_SENSORS, LENGTH_GEARBOX_SENSORS, sample_us);
    put16(frame->data + AT_CONTENT, scan->brake_20pa);
    put16(frame->data + 9, scan->supply_20pa);
    put16(frame->data + 11, within(scan->oil_centidegree, 4000, 30000));
    put16(frame->data + 13, within(scan->clutch_basispoint, 0, 10000));
}

void frames_put_sleeves(struct frame *frame, uint32_t sample_us,
                        const struct hal_scan scans[HAL_SCANS], unsigned first, uint8_t faults) {
    begin(frame, first == 0 ? ID_SLEEVES_MAIN : ID_SLEEVES_AUX, LENGTH_SLEEVES, sample_us);
    frame->data[AT_CONTENT] = faults;
    for (unsigned i = 0; i < HAL_SCANS; i++) {
        put16(frame->data + 8 + 2 * i, (uint16_t)scans[i].sleeve_um[first]);
        put16(frame->data + 28 + 2 * i, (uint16_t)scans[i].sleeve_um[first + 1]);
    }
}

void frames_put_valve_status(struct frame *frame, const struct valve_report *report) {
    begin(frame, ID_VALVE_STATUS, LENGTH_VALVE_STATUS, report->sample_us);
    put16(frame->data + AT_CONTENT, report->energised);
    put16(frame->data + 9, report->pending);
    put16(frame->data + 11, report->refused_count);
    put16(frame->data + 13, report->expired_count);
}

void frames_send(struct frame *frame, uint8_t *counter) {
    e2e_protect(frame->data, frame->length, frames_data_id(frame->id), *counter);
    *counter = (uint8_t)(*counter + 1);
    hal_send(frame);
}

uint32_t frames_get_time(const struct frame *frame) {
    return get32(frame->data + AT_TIME);
}

void frames_get_valve_command(const struct frame *frame, struct valve_order orders[HAL_VALVES]) {
    uint32_t actions = get32(frame->data + E2E_HEADER);
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        orders[i].action = (enum valve_action)(actions >> 2 * i & 3);
        orders[i].time_us = get32(frame->data + 6 + 4 * i);
    }
}

bool frames_get_clutch_command(const struct frame *frame, bool *close) {
    *close = frame->data[E2E_HEADER] == 1;
    return frame->data[E2E_HEADER] <= 1;
}
