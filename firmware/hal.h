/* The hardware as the firmware sees it. A board implements this header; no other file knows a
 * register, so that the same sources run on a board and natively (native/). Never run on silicon.
 *
 * Two clocks, both 32 bits of microseconds: the sensor clock stamps edges and samples and times the
 * valves, and two boards may share it by a wire. The board's own timer is set by nobody. */
#ifndef HAL_H
#define HAL_H

#include <stdbool.h>
#include <stdint.h>

enum {
    HAL_WHEELS = 4,   /* input, layshaft, main, propeller */
    HAL_CHANNELS = 8, /* of each wheel the rising edges, then the falling ones */
    HAL_SLEEVES = 4,  /* first/second, crawl/third, splitter, range */
    HAL_SCANS = 10,   /* of the analogue inputs in a cycle, 1 ms apart */
    HAL_VALVES = 9    /* in the order of ValveCommand */
};

/* A CAN frame. Ours have 29 bits of identifier and are CAN FD with bit rate switch. */
struct frame {
    uint32_t id;
    uint8_t length;
    bool is_extended;
    bool is_fd;
    uint8_t data[64];
};

/* The analogue inputs at one instant, scaled to the wire's steps by the board. */
struct hal_scan {
    int16_t sleeve_um[HAL_SLEEVES];
    uint16_t brake_20pa; /* absolute pressures in steps of 20 Pa */
    uint16_t supply_20pa;
    uint16_t oil_centidegree;   /* 0 is -100 degrees Celsius */
    uint16_t clutch_basispoint; /* of closed: 10,000 is closed */
    uint8_t bad_sleeves;        /* one bit a sleeve: its signal is out of electrical range */
};

uint32_t hal_sensor_us(void);
uint32_t hal_own_us(void);

/* Sets the sensor clock on by so much, or back. */
void hal_shift_sensor(int32_t by_us);

/* Begins a pulse on the wire to a board that has valves alone, where it is a rising edge of the
 * first wheel. */
void hal_sync_pulse(void);

/* Takes the oldest edge captured on a channel up to a sensor time; false where there is none. */
bool hal_next_edge(unsigned channel, uint32_t until_us, uint32_t *stamp_us);

/* Whether a wheel's supply or signal is out of range, or edges of it were lost. */
bool hal_wheel_is_bad(unsigned wheel);

/* The last ten scans, newest first; true once each 10 ms, as the newest one has been made. The time
 * is that of its sleeves: the middle of the time in which they were sampled. */
bool hal_scans(struct hal_scan scans[HAL_SCANS], uint32_t *sampled_us);

/* Puts a frame into the transmit queue, which keeps the order. Where it is full the oldest frame in
 * it is lost, and none is sent that has waited for HAL_OLDEST_US and a millisecond. */
enum { HAL_OLDEST_US = 20000 };
void hal_send(const struct frame *frame);

/* Called each millisecond: takes back what has waited for too long, and brings a CAN controller that
 * is off the bus back to it, with nothing to send. */
void hal_keep_bus(void);

/* Whether all frames that were to be sent have gone. */
bool hal_is_all_sent(void);

/* Whether the CAN controller has taken itself off the bus. */
bool hal_is_bus_off(void);

/* Drives exactly these valves, one bit each; and which are driven, read back from the outputs. */
void hal_drive(uint16_t valves);
uint16_t hal_driven(void);

/* Closes the clutch, or lets its actuator open it. */
void hal_close_clutch(bool close);

/* Calls `board_on_time` at this time of a clock, at once where it has passed; the last one set
 * holds. */
void hal_wake_at_sensor(uint32_t sensor_us);
void hal_wake_at_own(uint32_t own_us);

/* Toggles a wheel's pin once, at this time, which lies ahead, and calls `board_on_toggled` then. The
 * pins of the image teeth; low at reset. */
void hal_toggle_at(unsigned wheel, uint32_t sensor_us);

/* Says that the main loop goes on. The next tick restarts the watchdog where this was said since
 * the last one; HAL_WATCHDOG_US after the last restart it resets the board. */
enum { HAL_WATCHDOG_US = 2000 };
void hal_watchdog(void);

/* Keeps interrupts from coming between; not nested. */
void hal_lock(void);
void hal_unlock(void);

#endif
