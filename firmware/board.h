/* The images: sensor, valve, or both on one board, by IMAGE_SENSOR and IMAGE_VALVE (1 or 0); or
 * teeth by IMAGE_TEETH. */
#ifndef BOARD_H
#define BOARD_H

#include "hal.h"

/* From reset, before interrupts are let in. */
void board_power_on(void);

/* The body of the main loop: each millisecond, and as the tenth scan has been made. */
void board_poll(void);

/* Interrupts: a frame was received; a time has come; the processor has found a fault. All are of
 * one priority, so that none comes between another. */
void board_on_frame(const struct frame *frame);
void board_on_time(void);
void board_on_fault(void);
void board_on_toggled(unsigned wheel); /* teeth.c */

#endif
