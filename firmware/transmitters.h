/* The analogue inputs of the bench: which transmitter gives which value. Another bench has its own
 * ranges in transmitters.c. */
#ifndef TRANSMITTERS_H
#define TRANSMITTERS_H

#include "hal.h"

enum {
    TRANSMITTERS = 8,            /* the four sleeves, brake, supply, oil, clutch */
    TRANSMITTER_FULL = 4095 * 16 /* of a reading: 12 bits, 16 samples added */
};

/* Whether a signal from 10 to 90 % of full scale is beyond 5 or 95: a wire is broken or shorted. */
bool transmitter_is_broken(uint32_t reading);

/* What these readings say. */
void transmitters_scale(const volatile uint16_t readings[TRANSMITTERS], struct hal_scan *scan);

#endif
