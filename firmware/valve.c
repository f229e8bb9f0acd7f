#include "valve.h"

#include "outputs.h"
#include "sync.h"
#include "valves.h"

enum { CLUTCH_EXPIRY_US = 100000, LONGEST_SLEEP_US = 1000000 };

static struct valves valves;
static bool is_clutch_closed;
static uint32_t clutch_expiry_us; /* own time; where it is closed */

static void set_clutch(bool close) {
    is_clutch_closed = close;
    hal_close_clutch(close);
}

/* Until when the board may sleep: the earlier end of what commands hold. */
static uint32_t next_expiry_us(uint32_t own_us) {
    uint32_t wait_us = valves.is_held ? valves.expiry_us - own_us : LONGEST_SLEEP_US;
    if (is_clutch_closed && clutch_expiry_us - own_us < wait_us) {
        wait_us = clutch_expiry_us - own_us;
    }
    return own_us + wait_us;
}

/* Nothing is driven, nothing waits, and commands count anew once three good ones have come. */
static void let_go(void) {
    valves_clear(&valves);
    set_clutch(false);
    frames_forget();
}

/* Brings outputs and timers to what the rules say. */
static void apply(void) {
    if (hal_is_bus_off() || !sync_is_known()) {
        let_go();
    }
    outputs_drive(valves_wanted(&valves));
    hal_wake_at_sensor(valves_next_us(&valves));
    hal_wake_at_own(next_expiry_us(hal_own_us()));
}

void valve_power_on(void) {
    static const struct valves EMPTY;
    valves = EMPTY;
    sync_power_on();
    valve_on_fault();
}

void valve_on_fault(void) {
    let_go();
    apply();
}

static void run(void) {
    uint32_t own_us = hal_own_us();
    frames_watch(own_us);
    sync_run(own_us);
    valves_run(&valves, hal_sensor_us(), own_us);
    if (is_clutch_closed && (int32_t)(own_us - clutch_expiry_us) >= 0) {
        set_clutch(false);
    }
}

void valve_on_time(void) {
    run();
    apply();
}

void valve_on_frame(const struct frame *frame) {
    struct command command;
    if (!frame->is_extended) {
        return;
    }
    run(); /* what was due comes first: a command that has expired is not renewed */
    frames_hear(frame, hal_own_us(), &command);
    if (command.has_orders) {
        valves_command(&valves, command.orders, hal_sensor_us(), hal_own_us());
    }
    if (command.has_clutch) {
        set_clutch(command.close_clutch);
        clutch_expiry_us = hal_own_us() + CLUTCH_EXPIRY_US;
    }
    if (frame->id == ID_GEARBOX_SENSORS) {
        sync_on_frame(frame);
    }
    apply();
}

void valve_cycle(void) {
    hal_lock();
    struct valve_report report = {hal_sensor_us(), hal_driven(), valves_pending(&valves),
                                  valves.refused_count, valves.expired_count};
    hal_unlock();
    frames_send_valves(&report);
}
