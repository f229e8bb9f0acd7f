#include "valve.h"

#include "e2e.h"
#include "outputs.h"
#include "sync.h"
#include "valves.h"

enum { CLUTCH_EXPIRY_US = 100000, LONGEST_SLEEP_US = 1000000 };

static struct valves valves;
static struct e2e_channel valve_channel;
static struct e2e_channel clutch_channel;
static bool is_clutch_closed;
static uint32_t clutch_expiry_us; /* own time; where it is closed */
static uint8_t counter;

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
    static const struct e2e_channel UNHEARD;
    valves_clear(&valves);
    set_clutch(false);
    valve_channel = clutch_channel = UNHEARD;
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
    counter = 0;
    sync_power_on();
    valve_on_fault();
}

void valve_on_fault(void) {
    let_go();
    apply();
}

static void run(void) {
    uint32_t own_us = hal_own_us();
    e2e_watch(&valve_channel, own_us);
    e2e_watch(&clutch_channel, own_us);
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

static void command_valves(const struct frame *frame) {
    enum e2e_status status =
        frames_check(&valve_channel, frame, ID_VALVE_COMMAND, LENGTH_VALVE_COMMAND);
    if (e2e_update(&valve_channel, status, hal_own_us())) {
        struct valve_order orders[HAL_VALVES];
        frames_get_valve_command(frame, orders);
        valves_command(&valves, orders, hal_sensor_us(), hal_own_us());
    }
}

static void command_clutch(const struct frame *frame) {
    bool close = false;
    enum e2e_status status =
        frames_check(&clutch_channel, frame, ID_CLUTCH_COMMAND, LENGTH_CLUTCH_COMMAND);
    if (status == E2E_OK && !frames_get_clutch_command(frame, &close)) {
        status = E2E_ERROR;
    }
    if (e2e_update(&clutch_channel, status, hal_own_us())) {
        set_clutch(close);
        clutch_expiry_us = hal_own_us() + CLUTCH_EXPIRY_US;
    }
}

void valve_on_frame(const struct frame *frame) {
    if (!frame->is_extended) {
        return;
    }
    run(); /* what was due comes first: a command that has expired is not renewed */
    if (frame->id == ID_VALVE_COMMAND) {
        command_valves(frame);
    } else if (frame->id == ID_CLUTCH_COMMAND) {
        command_clutch(frame);
    } else if (frame->id == ID_GEARBOX_SENSORS) {
        sync_on_frame(frame);
    }
    apply();
}

void valve_cycle(void) {
    struct frame frame;
    hal_lock();
    struct valve_report report = {hal_sensor_us(), hal_driven(), valves_pending(&valves),
                                  valves.refused_count, valves.expired_count};
    hal_unlock();
    frames_put_valve_status(&frame, &report);
    frames_send(&frame, &counter);
}
