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

static uint16_t get16(const uint8_t *from) {
    return (uint16_t)(from[0] | from[1] << 8);
}

static uint32_t get32(const uint8_t *from) {
    return get16(from) | (uint32_t)get16(from + 2) << 16;
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

bool frames_get_edges(const struct frame *frame, struct edge_read *read) {
    read->read_us = get32(frame->data + AT_TIME);
    read->newest_index = get16(frame->data + AT_CONTENT);
    read->valid_stamps = frame->data[9] & 31;
    for (unsigned i = 0; i < EDGE_STAMPS; i++) {
        read->stamps_us[i] = get16(frame->data + 10 + 2 * i);
    }
    return read->valid_stamps <= EDGE_STAMPS;
}

void frames_put_gearbox_sensors(struct frame *frame, uint32_t sample_us,
                                const struct hal_scan *scan) {
    begin(frame, ID_GEARBOX_SENSORS, LENGTH_GEARBOX_SENSORS, sample_us);
    put16(frame->data + AT_CONTENT, scan->brake_20pa);
    put16(frame->data + 9, scan->supply_20pa);
    put16(frame->data + 11, scan->oil_centidegree);
    put16(frame->data + 13, scan->clutch_basispoint);
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

#if !PROFILE_CLASSIC

static uint8_t counters[HAL_CHANNELS + 4];
static struct e2e_channel valve_channel;
static struct e2e_channel clutch_channel;

void frames_power_on(void) {
    for (unsigned i = 0; i < sizeof counters; i++) {
        counters[i] = 0;
    }
}

void frames_forget(void) {
    static const struct e2e_channel UNHEARD;
    valve_channel = UNHEARD;
    clutch_channel = UNHEARD;
}

void frames_watch(uint32_t own_us) {
    e2e_watch(&valve_channel, own_us);
    e2e_watch(&clutch_channel, own_us);
}

/* Writes the header and sends it; the next frame of this message counts on. */
static void send(struct frame *frame, unsigned message) {
    e2e_protect(frame->data, frame->length, frames_data_id(frame->id), counters[message]++);
    hal_send(frame);
}

void frames_send_reads(const struct edge_read reads[HAL_CHANNELS], uint32_t now_us,
                       const struct hal_scan *scan) {
    struct frame frame;
    for (unsigned i = 0; i < HAL_CHANNELS; i++) {
        frames_put_edges(&frame, i, &reads[i]);
        send(&frame, i);
    }
    frames_put_gearbox_sensors(&frame, now_us, scan);
    send(&frame, HAL_CHANNELS);
}

void frames_send_valves(const struct valve_report *report) {
    struct frame frame;
    frames_put_valve_status(&frame, report);
    send(&frame, HAL_CHANNELS + 1);
}

void frames_send_sleeves(uint32_t sample_us, const struct hal_scan scans[HAL_SCANS],
                         unsigned faults) {
    struct frame frame;
    for (unsigned first = 0; first < HAL_SLEEVES; first += 2) {
        frames_put_sleeves(&frame, sample_us, scans, first, (uint8_t)(faults >> first & 3));
        send(&frame, HAL_CHANNELS + 2 + first / 2);
    }
}

void frames_hear(const struct frame *frame, uint32_t own_us, struct command *command) {
    enum e2e_status status;
    command->has_orders = false;
    command->has_clutch = false;
    if (frame->id == ID_VALVE_COMMAND) {
        status = frames_check(&valve_channel, frame, ID_VALVE_COMMAND, LENGTH_VALVE_COMMAND);
        command->has_orders = e2e_update(&valve_channel, status, own_us);
        frames_get_valve_command(frame, command->orders);
    } else if (frame->id == ID_CLUTCH_COMMAND) {
        status = frames_check(&clutch_channel, frame, ID_CLUTCH_COMMAND, LENGTH_CLUTCH_COMMAND);
        if (!frames_get_clutch_command(frame, &command->close_clutch) && status == E2E_OK) {
            status = E2E_ERROR;
        }
        command->has_clutch = e2e_update(&clutch_channel, status, own_us);
    }
}

#endif
