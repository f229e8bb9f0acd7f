/* The sensor side: what it reads and sends each 10 ms. */
#ifndef SENSOR_H
#define SENSOR_H

#include "edges.h"

void sensor_power_on(void);

/* Takes what the capture units have. Called each millisecond, so that their memory is small. */
void sensor_collect(void);

/* Reads the edges as they were at this time, at which the newest scan has the sleeves, and sends all
 * but the sleeves; then the sleeves of the same read. */
void sensor_cycle(struct hal_scan scans[HAL_SCANS], uint32_t sampled_us);
void sensor_send_sleeves(struct hal_scan scans[HAL_SCANS]);

#endif
