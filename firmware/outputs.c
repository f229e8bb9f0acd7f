#include "outputs.h"

#include "hal.h"

/* SplitLow and SplitHigh, MainFirst and MainSecond, MainCrawl and MainThird, RangeLow and
 * RangeHigh: the lower bit of each pair. Bit 0, the brake, stands alone. */
enum { ALL = (1 << HAL_VALVES) - 1, LOWER_OF_PAIR = 0xAA };

void outputs_drive(uint16_t wanted) {
    unsigned both = wanted & wanted >> 1 & LOWER_OF_PAIR;
    unsigned allowed = wanted & ALL & ~(both | both << 1);
    unsigned before = hal_driven();
    if (before == allowed) {
        return;
    }
    /* What goes off does so first: the two coils of a sleeve are never on together, not for the
     * time between two writes. */
    hal_drive((uint16_t)(before & allowed));
    hal_drive((uint16_t)allowed);
}
