#include "board.h"

#include "frames.h"
#include "sensor.h"
#include "teeth.h"
#include "valve.h"

#if !defined IMAGE_SENSOR || !defined IMAGE_VALVE || (IMAGE_SENSOR || IMAGE_VALVE) == IMAGE_TEETH
#error "compile with -DIMAGE_SENSOR=1 or 0 and -DIMAGE_VALVE=1 or 0; both 0 with -DIMAGE_TEETH=1"
#endif

void board_power_on(void) {
#if IMAGE_VALVE
    valve_power_on(); /* first of all: whatever was driven is off */
#endif
    frames_power_on();
#if IMAGE_SENSOR
    sensor_power_on();
#endif
}

/* What is sent each 10 ms, in the order in which the rig sends it: a bus is alike with either. */
static void cycle(struct hal_scan scans[HAL_SCANS], uint32_t sampled_us) {
#if IMAGE_SENSOR
    sensor_cycle(scans, sampled_us);
    hal_watchdog(); /* a cycle may take a tick's time, with interrupts between */
#endif
#if IMAGE_VALVE
    valve_cycle();
#endif
#if IMAGE_SENSOR
    sensor_send_sleeves(scans);
#else
    (void)scans;
    (void)sampled_us;
#endif
}

/* The watchdog is told here and in `cycle` alone: a main loop that is stuck resets the board. */
void board_poll(void) {
    struct hal_scan scans[HAL_SCANS];
    uint32_t sampled_us;
    hal_watchdog();
    board_on_time();
    hal_keep_bus();
    if (hal_scans(scans, &sampled_us)) {
        cycle(scans, sampled_us); /* before edges of a later time are taken */
    }
#if IMAGE_SENSOR
    sensor_collect();
#elif IMAGE_TEETH
    teeth_poll();
#endif
}

void board_on_frame(const struct frame *frame) {
#if IMAGE_VALVE
    valve_on_frame(frame);
#elif IMAGE_TEETH
    teeth_on_frame(frame);
#else
    (void)frame;
#endif
}

void board_on_time(void) {
#if IMAGE_VALVE
    hal_lock(); /* the main loop comes here as well as the interrupts */
    valve_on_time();
    hal_unlock();
#endif
}

void board_on_fault(void) {
#if IMAGE_VALVE
    valve_on_fault();
#endif
}
