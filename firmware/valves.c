#include "valves.h"

enum { MOST_LATE_US = 2000, MOST_AHEAD_US = 100000, EXPIRY_US = 100000, LONGEST_WAIT_US = 1000000 };

static bool is_same(const struct activation *a, const struct activation *b) {
    return a->is_set && a->on == b->on && a->at_us == b->at_us;
}

/* Takes an order; whether it is refused now. */
static bool take(struct valve_slot *slot, const struct valve_order *order, int64_t now_us) {
    if (order->action == OFF_NOW || order->action == ON_NOW) {
        slot->pending.is_set = false;
        slot->is_on = order->action == ON_NOW;
        return false;
    }
    int32_t ahead_us = (int32_t)(order->time_us - (uint32_t)now_us);
    struct activation wanted = {true, order->action == ON_AT, now_us + ahead_us};
    if (is_same(&slot->pending, &wanted)) {
        return false;
    }
    slot->pending.is_set = false;
    if (is_same(&slot->passed, &wanted) || is_same(&slot->refused, &wanted)) {
        return false;
    }
    if (ahead_us < -MOST_LATE_US || ahead_us > MOST_AHEAD_US) {
        slot->refused = wanted;
        return true;
    }
    slot->pending = wanted; /* one that is late already is done by the run that follows */
    return false;
}

/* Does what is due; whether anything was. */
static bool activate(struct valve_slot *slot, int64_t now_us) {
    if (!slot->pending.is_set || slot->pending.at_us > now_us) {
        return false;
    }
    slot->is_on = slot->pending.on;
    slot->passed = slot->pending;
    slot->pending.is_set = false;
    return true;
}

/* Both valves of a sleeve: what one does switches the other off, so that ON_AT of one and OFF_AT of
 * the other say a pulse whole. Of two that are due the later one is left; of one instant, an on. */
static void activate_both(struct valve_slot *a, struct valve_slot *b, int64_t now_us) {
    bool is_a = activate(a, now_us);
    bool is_b = activate(b, now_us);
    if (is_a && is_b) {
        is_b = b->passed.at_us > a->passed.at_us ||
               (b->passed.at_us == a->passed.at_us && b->passed.on);
    }
    if (is_b) {
        a->is_on = false;
    } else if (is_a) {
        b->is_on = false;
    }
}

/* The sensor clock as it goes on: a step of it goes back at most half of its range. */
static void unwrap(struct valves *valves, uint32_t sensor_us) {
    valves->clock_us += (int32_t)(sensor_us - (uint32_t)valves->clock_us);
}

void valves_command(struct valves *valves, const struct valve_order orders[HAL_VALVES],
                    uint32_t sensor_us, uint32_t own_us) {
    valves_run(valves, sensor_us, own_us);
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        if (take(&valves->slots[i], &orders[i], valves->clock_us)) {
            valves->refused_count++;
        }
    }
    valves->is_held = true;
    valves->expiry_us = own_us + EXPIRY_US;
    valves_run(valves, sensor_us, own_us);
}

void valves_run(struct valves *valves, uint32_t sensor_us, uint32_t own_us) {
    unwrap(valves, sensor_us);
    (void)activate(&valves->slots[0], valves->clock_us); /* the brake */
    for (unsigned i = 1; i < HAL_VALVES; i += 2) {
        activate_both(&valves->slots[i], &valves->slots[i + 1], valves->clock_us);
    }
    if (valves->is_held && (int32_t)(own_us - valves->expiry_us) >= 0) {
        valves->expired_count++;
        valves_clear(valves);
    }
}

void valves_clear(struct valves *valves) {
    valves->is_held = false;
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        valves->slots[i].is_on = false;
        valves->slots[i].pending.is_set = false;
    }
}

uint16_t valves_wanted(const struct valves *valves) {
    unsigned wanted = 0;
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        wanted |= (unsigned)valves->slots[i].is_on << i;
    }
    return (uint16_t)wanted;
}

uint16_t valves_pending(const struct valves *valves) {
    unsigned pending = 0;
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        pending |= (unsigned)valves->slots[i].pending.is_set << i;
    }
    return (uint16_t)pending;
}

uint32_t valves_next_us(const struct valves *valves) {
    int64_t next_us = valves->clock_us + LONGEST_WAIT_US;
    for (unsigned i = 0; i < HAL_VALVES; i++) {
        const struct activation *pending = &valves->slots[i].pending;
        if (pending->is_set && pending->at_us < next_us) {
            next_us = pending->at_us;
        }
    }
    return (uint32_t)next_us;
}
