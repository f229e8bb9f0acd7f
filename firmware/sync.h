/* The sensor clock of another board, for an image that has valves alone: a wire on the input of the
 * first wheel tells when that board reads, and its GearboxSensors which time that was. */
#ifndef SYNC_H
#define SYNC_H

#include "hal.h"

/* The clock is not known. */
void sync_power_on(void);

/* Takes the pulses that have come, and note of the time. Called each millisecond, and before a
 * frame. */
void sync_run(uint32_t own_us);

/* GearboxSensors has been received: sets the sensor clock by it and its pulse. */
void sync_on_frame(const struct frame *frame);

/* Whether the sensor clock is known; a board that has sensors has the clock. */
bool sync_is_known(void);

#endif
