/* Random and damaged frames, edges, scans and clocks into the board of memory: fuzz COUNT [SEED].
 * Built with -fsanitize=address,undefined, which ends it at the first fault; ends with 1 where the
 * two valves of a sleeve were driven together, anything was 101 ms after the last frame that can
 * have been a valid command, or an image that has valves drove them too seldom to show anything. */
#include <stdio.h>
#include <stdlib.h>

#include "../e2e.h"
#include "../frames.h"
#include "native.h"

enum { OFF_US = 101000, DRIVES_IN = 50 /* frames, or more often */ };

static uint32_t state;

static uint32_t any(uint32_t below) /* xorshift */
{
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state % below;
}

static uint32_t around_now(void) {
    return native.sensor_us + any(110000) - 4000;
}

#if PROFILE_CLASSIC
enum { ID_COMMAND = 0x0CFF9103, ID_TIME = 0x0CFF9003, LENGTH_COMMAND = 8, COUNTERS = 15 };

static void protect(uint8_t *data, uint32_t id) { /* AUTOSAR E2E profile 1 */
    data[0] = 0;
    for (unsigned i = 0; i <= LENGTH_COMMAND; i++) {
        data[0] ^= i == 0 ? (uint8_t)(id >> 8 & 0xFF) : i == 1 ? 0x4E : data[i - 1];
        for (unsigned bit = 0; bit < 8; bit++) {
            data[0] = (uint8_t)(data[0] << 1 ^ (data[0] >> 7) * 0x1D);
        }
    }
}

/* ValveOrders with the next counter, behind a ValveTime of nearly each valve. */
static void make_command(uint8_t *data, uint8_t *counter) {
    uint8_t time[LENGTH_COMMAND] = {0};
    *counter = (uint8_t)((*counter + 1) % COUNTERS);
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        uint32_t at_us = around_now();
        time[1] = (uint8_t)(any(COUNTERS) | (uint32_t)*counter << 4);
        time[2] = (uint8_t)(i | (at_us & 15) << 4);
        for (unsigned byte = 0; byte < 4; byte++) {
            time[3 + byte] = (uint8_t)(at_us >> (4 + 8 * byte) & 0xFF);
        }
        protect(time, ID_TIME);
        if (any(50) != 0) {
            native_receive(ID_TIME, time, sizeof time, 1, 0);
        }
    }
    uint32_t first_us = around_now();
    data[1] = (uint8_t)(*counter | any(16) << 4);
    for (unsigned byte = 0; byte < 4; byte++) {
        data[4 + byte] = (uint8_t)(first_us >> 8 * byte & 0xFF);
    }
    protect(data, ID_COMMAND);
}
#else
enum { ID_COMMAND = ID_VALVE_COMMAND, LENGTH_COMMAND = LENGTH_VALVE_COMMAND };

/* A whole command with the next counter, and times around now. */
static void make_command(uint8_t *data, uint8_t *counter) {
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        uint32_t at_us = around_now();
        for (unsigned byte = 0; any(8) != 0 && byte < 4; byte++) {
            data[6 + 4 * i + byte] = (uint8_t)(at_us >> 8 * byte & 0xFF);
        }
    }
    e2e_protect(data, LENGTH_COMMAND, frames_data_id(ID_COMMAND), ++*counter);
}
#endif

/* A read of another board: its pulse, and the frame that dates it, for an image of valves alone. */
static void send_sync(void) {
    static uint8_t counter, data[LENGTH_GEARBOX_SENSORS];
    uint32_t pulse_us = native.sensor_us;
    uint32_t read_us = any(40) ? pulse_us + any(40) - 20 : any(UINT32_MAX);
    native.edges_out[0] = native.edges_in[0]; /* a capture unit has none of the future */
    native_capture(0, &pulse_us, any(20) != 0);
    for (unsigned i = 0; i < 4; i++) {
        data[3 + i] = (uint8_t)(read_us >> 8 * i & 0xFF);
    }
    e2e_protect(data, sizeof data, frames_data_id(ID_GEARBOX_SENSORS), ++counter);
    native_receive(ID_GEARBOX_SENSORS, data, sizeof data, 1, 1);
}

/* A read's edge frames, for the image teeth; the others do not hear them. Most are as a rig's. */
static void send_edges(void) {
    static uint8_t counters[HAL_CHANNELS], data[LENGTH_EDGES];
    for (unsigned channel = 0; channel < HAL_CHANNELS; channel++) {
        uint32_t id = ID_EDGES + channel * ID_EDGES_STEP;
        uint32_t read_us = any(200) ? native.sensor_us - any(5000) : any(UINT32_MAX);
        for (unsigned i = E2E_HEADER; i < sizeof data; i++) {
            data[i] = (uint8_t)(i < 7 ? read_us >> 8 * (i - 3) & 0xFF : any(256));
        }
        data[8] = (uint8_t)(any(20) ? 0 : data[8]); /* the index goes on by little */
        data[9] = (uint8_t)(any(20) ? EDGE_STAMPS : data[9]);
        counters[channel] = (uint8_t)(counters[channel] + (any(20) ? 1 : any(4)));
        e2e_protect(data, sizeof data, frames_data_id(id), counters[channel]);
        native_receive(id, data, sizeof data, 1, 1);
    }
}

/* Sends one; whether it may have been a valid command. */
static bool send(uint8_t *counter) {
    static const uint32_t IDS[] = {ID_COMMAND, ID_CLUTCH_COMMAND, ID_VALVE_STATUS};
    uint8_t data[64];
    unsigned kind = any(4), length = any(65), id = IDS[any(3)];
    for (unsigned i = 0; i < sizeof data; i++) {
        data[i] = (uint8_t)any(256);
    }
    if (kind != 0) {
        id = ID_COMMAND;
        length = LENGTH_COMMAND;
        make_command(data, counter);
    }
    if (kind == 1) {
        data[any(LENGTH_COMMAND)] ^= (uint8_t)(1 + any(255));
    }
    native_receive(id, data, length, any(20) != 0,
                   (any(20) != 0) != PROFILE_CLASSIC);
    return kind >= 2;
}

static void stir(void) {
    uint32_t stamps[40];
    for (unsigned i = 0; i < 40; i++) {
        stamps[i] = native.sensor_us - any(any(2) ? 20000 : UINT32_MAX);
    }
    native_capture(any(HAL_CHANNELS), stamps, any(41));
    for (uint8_t *byte = (uint8_t *)native.scans; byte < (uint8_t *)(native.scans + HAL_SCANS);) {
        *byte++ = (uint8_t)any(256);
    }
    native.has_scans = native.bad_wheels = (uint8_t)any(2);
    native.is_bus_off = any(50) == 0;
    native.is_stuck = any(200) == 0;
    native.sent_count = 0;
    if (any(100) == 0) {
        native.sensor_us = any(UINT32_MAX);
    }
}

int main(int count, char **arguments) {
    uint32_t frames = count > 1 ? (uint32_t)strtoul(arguments[1], NULL, 10) : 10000;
    uint32_t last_us = 0, driven = 0;
    uint8_t counter = 0;
    state = count > 2 ? (uint32_t)strtoul(arguments[2], NULL, 10) : 1;
    native_power_on();
    for (uint32_t i = 0; i < frames; i++) {
        if (IMAGE_VALVE && !IMAGE_SENSOR) {
            send_sync();
        }
        last_us = send(&counter) ? native.own_us : last_us;
        send_edges();
        stir();
        native_advance(any(any(30) ? 12000 : 150000));
        driven += native.driven != 0;
        if (native.coils_together || (native.driven && native.own_us - last_us > OFF_US)) {
            printf("frame %u: valves %x\n", (unsigned)i, (unsigned)native.driven);
            return 1;
        }
    }
    printf("%u frames, something was driven after %u of them, %u resets\n", (unsigned)frames,
           (unsigned)driven, (unsigned)native.resets);
    return IMAGE_VALVE && driven < frames / DRIVES_IN;
}
