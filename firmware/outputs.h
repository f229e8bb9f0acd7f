/* The output stage: the last to decide what is driven. */
#ifndef OUTPUTS_H
#define OUTPUTS_H

#include <stdint.h>

/* Drives these valves, one bit each; of a sleeve whose two valves are both asked for, neither. */
void outputs_drive(uint16_t wanted);

#endif
