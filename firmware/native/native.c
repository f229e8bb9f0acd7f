#include "native.h"

enum { POLL_US = 1000 };

struct native native;

uint32_t hal_sensor_us(void) {
    return native.sensor_us;
}

uint32_t hal_own_us(void) {
    return native.own_us;
}

void hal_shift_sensor(int32_t by_us) {
    native.sensor_us += (uint32_t)by_us;
}

void hal_sync_pulse(void) {
    native.pulse_count++;
}

bool hal_next_edge(unsigned channel, uint32_t until_us, uint32_t *stamp_us) {
    uint32_t *out = &native.edges_out[channel];
    if (*out == native.edges_in[channel]) {
        return false;
    }
    *stamp_us = native.edges_us[channel][*out % NATIVE_EDGES];
    if ((int32_t)(until_us - *stamp_us) < 0) {
        return false;
    }
    ++*out;
    return true;
}

bool hal_wheel_is_bad(unsigned wheel) {
    return (native.bad_wheels >> wheel & 1) != 0;
}

bool hal_scans(struct hal_scan scans[HAL_SCANS], uint32_t *sampled_us) {
    bool is_new = native.has_scans != 0;
    native.has_scans = 0;
    *sampled_us = native.sensor_us;
    for (unsigned i = 0; i < HAL_SCANS; i++) {
        scans[i] = native.scans[i];
    }
    return is_new;
}

void hal_send(const struct frame *frame) {
    if (native.sent_count < NATIVE_SENT) {
        native.sent[native.sent_count++] = *frame;
    }
}

void hal_keep_bus(void) { /* it has no bus: what is sent is taken at once */
}

bool hal_is_all_sent(void) {
    return native.is_sending == 0;
}

bool hal_is_bus_off(void) {
    return native.is_bus_off != 0;
}

void hal_drive(uint16_t valves) {
    struct native_change change = {native.own_us, valves};
    if (valves != native.driven) {
        native.changes[native.change_count++ % NATIVE_CHANGES] = change;
    }
    native.driven = valves;
    native.coils_together += (valves & valves >> 1 & 0xAA) != 0;
}

uint16_t hal_driven(void) {
    return native.driven;
}

void hal_close_clutch(bool close) {
    native.is_clutch_closed = close;
    native.clutch_orders++;
}

void hal_wake_at_sensor(uint32_t sensor_us) {
    native.wake_sensor_us = sensor_us;
    native.is_wake_sensor_set = 1;
}

void hal_wake_at_own(uint32_t own_us) {
    native.wake_own_us = own_us;
    native.is_wake_own_set = 1;
}

void hal_toggle_at(unsigned wheel, uint32_t sensor_us) {
    native.toggle_us[wheel] = sensor_us;
    native.is_toggle_set[wheel] = 1;
}

void hal_watchdog(void) { /* a tick and the round behind it are at the same time here */
    native.watchdog_us = native.own_us + HAL_WATCHDOG_US;
}

/* There is nothing here that could come between. */
void hal_lock(void) {
}

void hal_unlock(void) {
}

void native_power_on(void) {
    hal_drive(0); /* outputs are off while a board is in reset */
    native.is_stuck = native.is_deaf = 0;
    native.poll_us = native.own_us + POLL_US;
    hal_watchdog();
    board_power_on();
    native.clutch_orders = 0;
}

/* How long until a time of a clock, nothing where it has passed. */
static uint32_t wait_us(uint32_t at_us, uint32_t now_us) {
    int32_t wait = (int32_t)(at_us - now_us);
    return wait < 0 ? 0 : (uint32_t)wait;
}

static uint32_t least(uint32_t a, uint32_t b) {
    return a < b ? a : b;
}

static uint32_t next_us(void) {
    uint32_t next = wait_us(native.watchdog_us, native.own_us);
    if (!native.is_stuck) {
        next = least(next, wait_us(native.poll_us, native.own_us));
    }
    if (native.is_wake_sensor_set && !native.is_deaf) {
        next = least(next, wait_us(native.wake_sensor_us, native.sensor_us));
    }
    if (native.is_wake_own_set && !native.is_deaf) {
        next = least(next, wait_us(native.wake_own_us, native.own_us));
    }
    for (unsigned i = 0; i < HAL_WHEELS; i++) {
        if (native.is_toggle_set[i]) {
            next = least(next, wait_us(native.toggle_us[i], native.sensor_us));
        }
    }
    return next;
}

static void toggle(unsigned wheel) {
    if (native.is_toggle_set[wheel] && wait_us(native.toggle_us[wheel], native.sensor_us) == 0) {
        native.is_toggle_set[wheel] = 0;
        native.toggled_us[wheel][native.toggled_count[wheel]++ % NATIVE_EDGES] = native.sensor_us;
        board_on_toggled(wheel);
    }
}

static void wake(uint8_t *is_set, uint32_t at_us, uint32_t now_us) {
    if (*is_set && !native.is_deaf && wait_us(at_us, now_us) == 0) {
        *is_set = 0;
        board_on_time();
    }
}

static void fire(void) {
    for (unsigned i = 0; i < HAL_WHEELS; i++) {
        toggle(i);
    }
    wake(&native.is_wake_sensor_set, native.wake_sensor_us, native.sensor_us);
    wake(&native.is_wake_own_set, native.wake_own_us, native.own_us);
    if (!native.is_stuck && wait_us(native.poll_us, native.own_us) == 0) {
        native.poll_us += POLL_US;
        board_poll();
    }
    if (wait_us(native.watchdog_us, native.own_us) == 0) {
        native.resets++;
        native_power_on();
    }
}

void native_advance(uint32_t us) {
    for (uint32_t next = next_us(); next <= us; next = next_us()) {
        native.sensor_us += next;
        native.own_us += next;
        us -= next;
        fire();
    }
    native.sensor_us += us;
    native.own_us += us;
}

/* Edges that the capture memory has no room for are lost, and the wheel says so. */
void native_capture(unsigned channel, const uint32_t *stamps_us, unsigned count) {
    for (unsigned i = 0; i < count; i++) {
        if (native.edges_in[channel] - native.edges_out[channel] == NATIVE_EDGES) {
            native.bad_wheels = (uint8_t)(native.bad_wheels | 1U << channel / 2);
            return;
        }
        native.edges_us[channel][native.edges_in[channel]++ % NATIVE_EDGES] = stamps_us[i];
    }
}

void native_receive(uint32_t id, const uint8_t *data, unsigned length, unsigned is_extended,
                    unsigned is_fd) {
    struct frame frame = {.id = id, .length = (uint8_t)length,
                          .is_extended = is_extended != 0, .is_fd = is_fd != 0};
    for (unsigned i = 0; i < length && i < sizeof frame.data; i++) {
        frame.data[i] = data[i];
    }
    if (!native.is_deaf && !native.is_bus_off) {
        board_on_frame(&frame);
    }
}
