/* The valve side: commands in, outputs and ValveStatus out. */
#ifndef VALVE_H
#define VALVE_H

#include "hal.h"

/* Everything off, nothing heard. */
void valve_power_on(void);

/* A frame has been received (interrupt). */
void valve_on_frame(const struct frame *frame);

/* One of the times set by hal_wake_at_... has come (interrupt); and each millisecond, should one
 * have been missed. */
void valve_on_time(void);

/* From a fault handler: everything off, before the watchdog resets the board. */
void valve_on_fault(void);

/* Sends ValveStatus, each 10 ms. */
void valve_cycle(void);

#endif
