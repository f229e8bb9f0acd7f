/* The rules of ValveCommand (docs/wire.md): one pending slot a valve, refusal, expiry. */
#ifndef VALVES_H
#define VALVES_H

#include "frames.h"

/* An activation as it was received; its time in the sensor clock, unwrapped. */
struct activation {
    bool is_set;
    bool on;
    int64_t at_us;
};

struct valve_slot {
    bool is_on;
    struct activation pending;
    struct activation passed;  /* the last one that was done: it is never armed again */
    struct activation refused; /* the last one that was refused: it is counted once */
};

/* All zero at power-on. */
struct valves {
    struct valve_slot slots[HAL_VALVES];
    int64_t clock_us;     /* the sensor clock, unwrapped */
    bool is_held;         /* a command holds, until: */
    uint32_t expiry_us;   /* own time */
    uint16_t refused_count;
    uint16_t expired_count;
};

/* A valid frame, taken now by both clocks. */
void valves_command(struct valves *valves, const struct valve_order orders[HAL_VALVES],
                    uint32_t sensor_us, uint32_t own_us);

/* Does what is due now by either clock. */
void valves_run(struct valves *valves, uint32_t sensor_us, uint32_t own_us);

/* Switches everything off and empties all slots. */
void valves_clear(struct valves *valves);

/* One bit a valve: which are to be driven, which wait. */
uint16_t valves_wanted(const struct valves *valves);
uint16_t valves_pending(const struct valves *valves);

/* When the earliest activation is due, in the sensor clock; at most a second from now, for a clock
 * that has jumped back may have one wait for longer than 32 bits can tell. */
uint32_t valves_next_us(const struct valves *valves);

#endif
