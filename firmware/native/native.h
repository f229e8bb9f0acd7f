/* A board of memory: what Python, or the fuzzer, puts into it is what the firmware sees. */
#ifndef NATIVE_H
#define NATIVE_H

#include "../board.h"

enum { NATIVE_EDGES = 256, NATIVE_SENT = 64, NATIVE_CHANGES = 64 };

struct native_change {
    uint32_t own_us;
    uint16_t driven;
};

struct native {
    uint32_t sensor_us;
    uint32_t own_us;
    uint32_t wake_sensor_us; /* as the firmware has set them */
    uint32_t wake_own_us;
    uint32_t watchdog_us; /* own time at which it resets the board */
    uint32_t poll_us;     /* own time of the main loop's next round */
    uint32_t resets;      /* by the watchdog */
    uint32_t coils_together; /* how often both valves of a sleeve were driven */
    uint32_t change_count;
    uint32_t clutch_orders; /* how often its output was set since power-on */
    uint32_t sent_count;
    uint32_t pulse_count; /* on the wire to a board with valves alone */
    uint16_t driven;
    uint8_t is_wake_sensor_set;
    uint8_t is_wake_own_set;
    uint8_t is_clutch_closed;
    uint8_t is_bus_off;
    uint8_t is_sending; /* a frame waits for the bus */
    uint8_t has_scans;
    uint8_t bad_wheels;
    uint8_t is_stuck;                             /* the main loop */
    uint8_t is_deaf;                              /* no interrupt is served */
    struct native_change changes[NATIVE_CHANGES]; /* of the outputs; the newest are kept */
    struct frame sent[NATIVE_SENT];
    struct hal_scan scans[HAL_SCANS];
    uint32_t edges_us[HAL_CHANNELS][NATIVE_EDGES];
    uint32_t edges_in[HAL_CHANNELS];
    uint32_t edges_out[HAL_CHANNELS];
    uint32_t toggle_us[HAL_WHEELS]; /* as the firmware has set them */
    uint8_t is_toggle_set[HAL_WHEELS];
    uint32_t toggled_us[HAL_WHEELS][NATIVE_EDGES]; /* of the pins; the newest are kept */
    uint32_t toggled_count[HAL_WHEELS];
};

extern struct native native;

void native_power_on(void);
/* Lets time go on, with all that comes in it. */
void native_advance(uint32_t us);
void native_capture(unsigned channel, const uint32_t *stamps_us, unsigned count);
void native_receive(uint32_t id, const uint8_t *data, unsigned length, unsigned is_extended,
                    unsigned is_fd);

#endif
