/* The image teeth: plays a rig's shafts as pulses on four pins; where there is none, a run-up. */
#ifndef TEETH_H
#define TEETH_H

#include "hal.h"

/* Edges since the rig was found, for a debugger. */
extern uint32_t teeth_reported;
extern uint32_t teeth_shown;

void teeth_poll(void);                          /* each millisecond */
void teeth_on_frame(const struct frame *frame); /* interrupt */

#endif
