/* The sensor side: what it reads and sends each 10 ms. */
#ifndef SENSOR_H
#define SENSOR_H

#include "edges.h"

void sensor_power_on(void);

/* Takes what the capture units have. Called each millisecond, so that their memory is small. */
void sensor_collect(void);

/* Reads everything at this instant, as the newest scan has been made, and sends all but the
 * sleeves; then the sleeves of the same read. */
void sensor_cycle(struct hal_scan scans[HAL_SCANS]);
void sensor_send_sleeves(struct hal_scan scans[HAL_SCANS]);

#endif
