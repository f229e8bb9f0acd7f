/* The classic profile, for a bus without CAN FD: frames of 8 bytes, bit for bit as
 * dbc/classic/meshpoint_classic.dbc has them, protected by AUTOSAR E2E profile 1. */
#include "frames.h"

#if PROFILE_CLASSIC

#if !IMAGE_SENSOR || !IMAGE_VALVE || !defined TEETH_INPUT || !defined TEETH_PROPELLER
#error "GearboxState is of both images on one board; ETC1 wants -DTEETH_INPUT, -DTEETH_PROPELLER"
#endif

enum {
    ID_READ = 0x18FF8080, /* of the first message below; the others are 0x100 apart */
    ID_ETC1 = 0x0CF00280,
    ID_VALVE_TIME = 0x0CFF9003,
    ID_VALVE_ORDERS = 0x0CFF9103
};

enum message { READ, LAYSHAFT, MAIN, STATE, SLEEVES_MAIN, SLEEVES_AUX, SLOW, MESSAGES };

enum {
    LENGTH = 8,
    COUNTERS = 15, /* they go from 0 to 14 */
    A_FRAME = 3,   /* edges */
    MOST_IN_FULL = 9,
    MEASURED_US = 15000, /* a speed is taken over so long at least, where there are edges */
    MOST_SPEED = 64255,  /* steps of 0.125 rpm */
    NO_SPEED = 0xFFFF
};

/* All zero at power-on. */
struct classic {
    uint8_t counters[MESSAGES]; /* of the next frames */
    unsigned reads;
    uint8_t read;     /* the counter of this one's SensorRead */
    uint64_t state;   /* what GearboxState says of brake and clutch */
    uint16_t sent[2]; /* number of the newest edge that was, of layshaft and main shaft */
    struct e2e_channel channel;
    uint32_t times_us[HAL_VALVES];
    uint8_t orders[HAL_VALVES]; /* to which a time belongs: their counter and 1; 0: there is none */
};

static struct classic classic;

void frames_power_on(void) {
    static const struct classic NOTHING;
    classic = NOTHING;
}

void frames_forget(void) {
    static const struct e2e_channel UNHEARD;
    classic.channel = UNHEARD;
}

void frames_watch(uint32_t own_us) {
    e2e_watch(&classic.channel, own_us);
}

/* CRC-8 (polynomial 0x1D) over the data ID, low byte first, and all behind the CRC itself. */
static uint8_t crc8_of(const struct frame *frame) {
    uint8_t crc = 0;
    for (unsigned i = 0; i <= LENGTH; i++) {
        crc ^= i == 0 ? (uint8_t)(frame->id >> 8 & 0xFF) : i == 1 ? 0x4E : frame->data[i - 1];
        for (unsigned bit = 0; bit < 8; bit++) {
            crc = (uint8_t)(crc << 1 ^ (crc >> 7) * 0x1D);
        }
    }
    return crc;
}

static void put(struct frame *frame, uint32_t id, uint64_t bits) {
    frame->id = id;
    frame->length = LENGTH;
    frame->is_extended = true;
    frame->is_fd = false;
    for (unsigned i = 0; i < LENGTH; i++) {
        frame->data[i] = (uint8_t)(bits & 0xFF);
        bits >>= 8;
    }
}

/* Sends a message of ours, which says `content` from bit 12 on. */
static void send(enum message message, uint64_t content) {
    struct frame frame;
    uint8_t counter = classic.counters[message];
    classic.counters[message] = (uint8_t)((counter + 1) % COUNTERS);
    put(&frame, ID_READ + message * 0x100U, content << 12 | (uint64_t)counter << 8);
    frame.data[0] = crc8_of(&frame);
    hal_send(&frame);
}

/* How many of a wheel's new edges go with this read: up to nine all of them; of more, the one or
 * two over whole frames wait for the next. */
static unsigned going(const struct edge_read *read, uint16_t *sent) {
    unsigned most = read->valid_stamps < A_FRAME ? 0 : read->valid_stamps;
    unsigned fresh = (uint16_t)(read->newest_index - *sent);
    fresh = fresh < most ? fresh : most;
    unsigned waits = fresh > MOST_IN_FULL ? fresh % A_FRAME : 0;
    *sent = (uint16_t)(read->newest_index - waits);
    return fresh - waits;
}

/* The oldest first, three a frame; the last one is filled up with edges that were sent before. */
static void send_edges(enum message message, const struct edge_read *read, uint16_t newest,
                       unsigned count) {
    unsigned waits = (uint16_t)(read->newest_index - newest);
    for (int left = (int)count; left > 0; left -= A_FRAME) {
        unsigned at = waits + (left > A_FRAME ? (unsigned)left - A_FRAME : 0);
        send(message, ((read->newest_index - at) & 15) | (uint64_t)read->stamps_us[at] << 4 |
                          (uint64_t)read->stamps_us[at + 1] << 20 |
                          (uint64_t)read->stamps_us[at + 2] << 36);
    }
}

/* In steps of 0.125 rpm: 480,000,000 edges / (us teeth), rounded; a division of 64 bits by hand. */
static uint64_t speed_of(const struct edge_read *read, uint32_t teeth) {
    uint32_t span_us = 0;
    uint32_t count = 0;
    uint32_t steps = 0;
    while (count + 1 < read->valid_stamps && span_us < MEASURED_US) {
        span_us += (uint16_t)(read->stamps_us[count] - read->stamps_us[count + 1]);
        count++;
    }
    if (read->sensor_fault || (!read->stopped && (span_us == 0 || read->long_interval))) {
        return NO_SPEED;
    }
    for (uint32_t bit = 0x8000; bit != 0 && !read->stopped; bit >>= 1) {
        uint64_t half_below = (2 * (uint64_t)(steps + bit) - 1) * span_us * teeth;
        steps += half_below <= UINT64_C(960000000) * count ? bit : 0;
    }
    return steps < MOST_SPEED ? steps : MOST_SPEED;
}

void frames_send_reads(const struct edge_read reads[HAL_CHANNELS], uint32_t now_us,
                       const struct hal_scan *scan) {
    (void)now_us; /* SensorRead dates the whole read */
    const struct edge_read *layshaft = &reads[2]; /* every second one has rising edges */
    const struct edge_read *main = &reads[4];
    unsigned of_layshaft = going(layshaft, &classic.sent[0]);
    unsigned of_main = going(main, &classic.sent[1]);
    classic.read = classic.counters[READ];
    classic.reads++;
    send(READ, layshaft->read_us | (uint64_t)(classic.sent[0] & 0xFF) << 32 |
                   (uint64_t)(classic.sent[1] & 0xFF) << 40 | (uint64_t)layshaft->stopped << 48 |
                   (uint64_t)main->stopped << 49 | (uint64_t)layshaft->sensor_fault << 50 |
                   (uint64_t)main->sensor_fault << 51);
    send_edges(LAYSHAFT, layshaft, classic.sent[0], of_layshaft);
    send_edges(MAIN, main, classic.sent[1], of_main);
    if (classic.reads % 5 == 0) {
        struct frame etc1; /* all but the speeds is not available: bits that are set */
        put(&etc1, ID_ETC1, 0xFF0000FFFF0000FFU | speed_of(&reads[6], TEETH_PROPELLER) << 8 |
                                speed_of(&reads[0], TEETH_INPUT) << 40);
        hal_send(&etc1);
    }
    if (classic.reads % 10 == 0) {
        send(SLOW, scan->supply_20pa | (uint64_t)scan->oil_centidegree << 16);
    }
    uint32_t brake_320pa = (scan->brake_20pa + 8U) / 16;
    classic.state = (uint64_t)(brake_320pa < 0xFFF ? brake_320pa : 0xFFF) << 4 |
                    (uint64_t)((scan->clutch_basispoint + 5U) / 10) << 16;
}

void frames_send_valves(const struct valve_report *report) {
    send(STATE, classic.read | classic.state | (uint64_t)report->energised << 26 |
                    (uint64_t)report->pending << 35 | (uint64_t)(report->refused_count & 15) << 44 |
                    (uint64_t)(report->expired_count & 15) << 48);
}

/* In steps of 10 um, halves up, 12 bits; nothing below 0 is divided. */
static uint64_t position(int16_t um) {
    return (uint64_t)((um + 40965) / 10) & 0xFFF;
}

void frames_send_sleeves(uint32_t sample_us, const struct hal_scan scans[HAL_SCANS],
                         unsigned faults) {
    (void)sample_us; /* the counter of SensorRead says which read it is */
    for (unsigned first = 0; first < (classic.reads % 2 == 0 ? HAL_SLEEVES : 2U); first += 2) {
        send(first == 0 ? SLEEVES_MAIN : SLEEVES_AUX,
             (classic.read & 3U) | (uint64_t)(faults >> first & 3) << 2 |
                 position(scans[0].sleeve_um[first]) << 4 |
                 position(scans[5].sleeve_um[first]) << 16 |
                 position(scans[0].sleeve_um[first + 1]) << 28 |
                 position(scans[5].sleeve_um[first + 1]) << 40);
    }
}

/* The bits of a frame; false where it is damaged, or none of ours. */
static bool get(const struct frame *frame, uint64_t *bits) {
    *bits = 0;
    for (unsigned i = 0; i < LENGTH; i++) {
        *bits = *bits << 8 | frame->data[LENGTH - 1 - i];
    }
    return frame->is_extended && !frame->is_fd && frame->length == LENGTH &&
           frame->data[0] == crc8_of(frame) && (frame->data[1] & 15) < COUNTERS;
}

/* Actions and times of ValveOrders; false where a ValveTime of them was not heard. */
static bool get_orders(uint64_t bits, struct valve_order orders[HAL_VALVES]) {
    bool is_whole = true;
    bool is_first = true;
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        orders[i].action = (enum valve_action)((uint32_t)bits >> (12 + 2 * i) & 3);
        orders[i].time_us = is_first ? (uint32_t)(bits >> 32) : classic.times_us[i];
        if (orders[i].action == OFF_AT || orders[i].action == ON_AT) {
            is_whole = is_whole && (is_first || classic.orders[i] == (bits >> 8 & 15) + 1);
            is_first = false;
        }
        classic.orders[i] = 0;
    }
    return is_whole;
}

static void hear_orders(uint64_t bits, bool is_intact, uint32_t own_us, struct command *command) {
    enum e2e_status status = E2E_ERROR;
    if (is_intact) {
        status = e2e_judge(&classic.channel, (uint8_t)(bits >> 8 & 15), COUNTERS);
        if (status != E2E_REPEATED && !get_orders(bits, command->orders)) {
            return; /* as if they had not come */
        }
    }
    command->has_orders = e2e_update(&classic.channel, status, own_us);
    command->close_clutch = (bits >> 30 & 3) == 2;
    command->has_clutch = command->has_orders && ((bits >> 30 & 3) == 1 || command->close_clutch);
}

void frames_hear(const struct frame *frame, uint32_t own_us, struct command *command) {
    uint64_t bits;
    bool is_intact = get(frame, &bits);
    unsigned valve = (unsigned)(bits >> 16 & 15);
    command->has_orders = false;
    command->has_clutch = false;
    if (frame->id == ID_VALVE_ORDERS) {
        hear_orders(bits, is_intact, own_us, command);
    } else if (frame->id == ID_VALVE_TIME && is_intact && valve < HAL_VALVES) {
        classic.times_us[valve] = (uint32_t)(bits >> 20);
        classic.orders[valve] = (uint8_t)((bits >> 12 & 15) + 1);
    }
}

#endif
