/* What DMA and interrupts of this board write. */
#ifndef MEMORY_H
#define MEMORY_H

#include "../transmitters.h"

enum { MHZ = 80, RING = 256 };

extern volatile uint16_t edges_low_us[HAL_CHANNELS][RING];
extern volatile uint32_t scanned_us; /* sensor clock as the newest scan began */
extern volatile uint16_t scans_raw[HAL_SCANS][TRANSMITTERS];
extern volatile uint16_t levels_raw[HAL_WHEELS];       /* of the Hall inputs, 0 to 4,095 */
extern volatile bool is_due;                           /* the main loop's next round */

#endif
