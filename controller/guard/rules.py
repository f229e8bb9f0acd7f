"""The guard: decodes the finished valve frame itself and passes it or blocks it. It uses no state
of the sequence, no estimate and no codec, so that an error there cannot reach a valve.

Each rule is a row of the table at the end of this file, under its number in docs/guard.md; what it
judges is in `case.py`. Slip and brake are judged for the time at which the command takes effect,
with the guard's own speeds and with bounds on what brake and drag can do until then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from meshpoint.controller.guard.case import (
    FOREVER_US,
    FRAME_LENGTH,
    MAIN_VALVES,
    NO_SPANS,
    VALVE_COUNT,
    GuardState,
    JudgedCommand,
    Span,
    Spans,
    decode,
    spans,
)
from meshpoint.controller.guard.face_pulse import sleeve_on_a_tooth
from meshpoint.controller.guard.last_call import slip_may_leave_its_window
from meshpoint.controller.guard.limits import (
    BRAKE_PRESSED_PA,
    CLEAR_M,
    CLUTCH_CLOSED_SHARE,
    GUARD_NEUTRAL_M,
    REACT_US,
    SLIP_MARGIN_RAD_S,
    SPLITTER,
    GuardLimits,
)
from meshpoint.controller.guard.sleeve_memory import note_sleeves, remember_drives
from meshpoint.controller.guard.view import GuardInputs

BRAKE: Final = 0
SPLIT_LOW, SPLIT_HIGH = 1, 2
RANGE_LOW, RANGE_HIGH = 7, 8
SLEEVE_VALVE_PAIRS: Final = ((1, 2), (3, 4), (5, 6), (7, 8))
"""The two valves of one sleeve: splitter, first/second, crawl/third, range."""
OTHER_END: Final = {1: 2, 2: 1, 7: 8, 8: 7}
"""Of splitter and range: the valve that pushes back."""
PROOF_STEPS: Final = 3
"""All inputs must have been valid in this many consecutive steps before a valve may be driven."""
SETTLED_US: Final = 2_000
"""In each of these the guard's clock may have gained so much: old frames that a bus still delivers
come faster than they were sent, and nothing else shows it. A step without frames proves nothing."""
CLOCK_ERROR_US: Final = 12_000
"""A tick and the bus: what one of two clocks may not have seen of the least delay."""
INPUT, LAYSHAFT, MAIN, PROPELLER = range(4)

Rule = Callable[[JudgedCommand], bool]


def both_valves_of_a_sleeve(case: JudgedCommand) -> bool:
    """Row 1: both valves of a sleeve are driven at one time. A release that is still to come
    counts."""
    return any(
        (one := case.spans[a]) is not None
        and (other := case.spans[b]) is not None
        and max(one.start_us, other.start_us) < min(one.end_us, other.end_us)
        for a, b in SLEEVE_VALVE_PAIRS
    )


def two_sleeves_of_the_main_box(case: JudgedCommand) -> bool:
    """Row 2: both commanded, or one commanded while the other is not proven neutral. One that goes
    back to neutral may do so while the other stands before its teeth. Nor is a splitter's sleeve
    driven to dog teeth together with one of the main box: both hold the layshaft."""
    driven = {case.limits.main[v].sleeve: v for v in MAIN_VALVES if case.spans[v] is not None}
    if driven and any(valve in case.limits.splitter for valve, _ in case.engaging()):
        return True
    return any(
        1 - sleeve in driven
        or not (
            case.is_neutral(1 - sleeve)
            or (case.brings_back(valve) and case.stands_apart(1 - sleeve))
        )
        for sleeve, valve in driven.items()
    )


def slip_out_of_its_window(case: JudgedCommand) -> bool:
    """Row 3: the slip cannot lie in the allowed window at any possible time of contact; at the last
    call, it may lie outside. With the clutch closed the engine can cause any slip, so the rule
    forbids engaging then."""
    return any(
        not case.is_parted(case.contact_us(valve, span)[0])
        or not _slip_can_fit(case, valve, span)
        or slip_may_leave_its_window(case, valve, span)
        for valve, span in case.engaging()
    )


def _slip_can_fit(case: JudgedCommand, valve: int, span: Span) -> bool:
    falling, ratio, holding, over = case.limits.dogs[valve].meeting
    falls, holds = case.seen.speeds[falling], case.seen.speeds[holding]
    if falls is None or holds is None:
        return True  # row 4 forbids engaging at an unknown speed
    limits = case.limits
    early_us, late_us = case.contact_us(valve, span)
    slip = ratio * falls.omega_rad_s - over * holds.omega_rad_s
    least_s, most_s = 0.0, 0.0
    if falling == LAYSHAFT:  # the brake is on it
        least_s, most_s = _braking_s(case, falls.time_us, early_us, late_us)
    constant, viscous = limits.drag_of(falling)
    drag = constant + viscous * falls.omega_rad_s
    drag_s = max(0.0, late_us - falls.time_us) * 1e-6
    fall_most = limits.brake_rad_s2[1] * most_s + drag * drag_s
    fall_least = limits.brake_rad_s2[0] * least_s
    low, high = limits.slip_rad_s
    return (
        slip - ratio * fall_most - SLIP_MARGIN_RAD_S <= high
        and slip - ratio * fall_least + SLIP_MARGIN_RAD_S >= low
    )


def _braking_s(
    case: JudgedCommand, from_us: float, early_us: float, late_us: float
) -> tuple[float, float]:
    """Least and greatest time (s) for which the brake acts between `from_us`, at which the speed
    was measured, and a contact between `early_us` and `late_us`."""
    limits, brake = case.limits, case.spans[BRAKE]
    tail_us = limits.brake_delay_us[1] + 3.0 * limits.brake_lag_us
    if brake is None:
        end_us = case.state.brake_off_us + tail_us
        return 0.0, max(0.0, min(late_us, end_us) - from_us) * 1e-6
    most_us = min(late_us, brake.end_us + tail_us) - max(from_us, brake.start_us)
    least_us = min(early_us, brake.end_us) - max(from_us, brake.start_us + tail_us)
    return max(0.0, least_us) * 1e-6, max(0.0, most_us) * 1e-6


def engage_on_unknown_speed(case: JudgedCommand) -> bool:
    """Row 4: the speed of a shaft that meets another stale or invalid: layshaft or main shaft, of
    a splitter with dog teeth input shaft or layshaft."""
    meetings = [case.limits.dogs[valve].meeting for valve, _ in case.engaging()]
    return any(case.speed(one.falls) is None or case.speed(one.holds) is None for one in meetings)


def brake_against_the_driveline(case: JudgedCommand) -> bool:
    """Row 5: air may come into the brake while a gear is in mesh or the clutch's plates may touch,
    or stay in it beyond the earliest contact of a sleeve that is driven. A release that is still to
    come counts. A sleeve that stands on a tooth may be moved on."""
    brake = case.spans[BRAKE]
    if brake is None:
        return False
    stands, sleeves = sleeve_on_a_tooth(case, brake), case.limits.dogs
    engaging = [driven for driven in case.engaging() if sleeves[driven[0]].sleeve != stands]
    approaching = {stands, *(sleeves[valve].sleeve for valve, _ in engaging)}
    acts_us = max(float(case.seen.now_us), brake.start_us + case.limits.brake_delay_us[0])
    in_mesh = not all(case.teeth_are_out(sleeve, acts_us) for sleeve in {0, 1} - approaching)
    meets = any(brake.end_us > case.contact_us(*driven)[0] for driven in engaging)
    return in_mesh or meets or not case.is_parted(acts_us)


def brake_beyond_its_limits(case: JudgedCommand) -> bool:
    """Row 6: the brake has been on for too long, has taken too much energy, or would slow the
    layshaft below its lowest allowed speed before it can be released."""
    brake, limits, now_us = case.spans[BRAKE], case.limits, case.seen.now_us
    if brake is None:
        return False
    too_long = now_us - brake.start_us > limits.brake_on_us
    too_hot = case.state.brake_j > limits.brake_j
    layshaft = case.seen.speeds[LAYSHAFT]
    if too_long or too_hot or layshaft is None:
        return True
    off_us = now_us + REACT_US + limits.brake_delay_us[1] + limits.brake_lag_us
    acting_us = max(0.0, off_us - max(layshaft.time_us, brake.start_us + limits.brake_delay_us[0]))
    lowest = layshaft.omega_rad_s - limits.brake_rad_s2[1] * acting_us * 1e-6
    return lowest < limits.brake_floor_rad_s


def driven_too_long_or_blind(case: JudgedCommand) -> bool:
    """Row 7: a valve has been on for longer than allowed, or is driven without valid inputs."""
    now_us = case.seen.now_us
    driven = [span for span in case.spans if span is not None]
    too_long = any(now_us - span.start_us > case.limits.valve_on_us for span in driven)
    return too_long or (bool(driven) and not case.seen.valid)


def range_change_out_of_neutral(case: JudgedCommand) -> bool:
    """Row 8: the range is changed with the main box not in neutral, or to low range at a speed at
    which the main shaft would turn too fast."""
    if case.spans[RANGE_LOW] is None and case.spans[RANGE_HIGH] is None:
        return False
    main_driven = any(case.spans[valve] is not None for valve in MAIN_VALVES)
    if main_driven or not case.main_is_neutral():
        return True
    if case.spans[RANGE_LOW] is None:
        return False
    propeller = case.speed(PROPELLER)
    if propeller is None:
        return True
    return propeller / case.limits.range_ratio[-1] > case.limits.main_max_rad_s


def input_overspeed(case: JudgedCommand) -> bool:
    """Row 9: the gear, or low split, would turn the input shaft too fast."""
    limits, main, layshaft = case.limits, case.speed(MAIN), case.speed(LAYSHAFT)
    side = _side(case.seen.positions_m[SPLITTER])
    for valve, _ in case.engaging():
        if valve in limits.splitter:
            if layshaft is None or limits.dogs[valve].ratio * layshaft > limits.input_max_rad_s:
                return True
            continue
        ratio = limits.main[valve].ratio * limits.split_ratio[side]
        if main is not None and main / ratio > limits.input_max_rad_s:
            return True
    if case.spans[SPLIT_LOW] is None or SPLIT_LOW in limits.splitter:
        return False
    return layshaft is None or layshaft / limits.split_ratio[-1] > limits.input_max_rad_s


def _side(position_m: float) -> int:
    """Side of the splitter, -1 low or +1 high; between the two, low: the faster input shaft."""
    return 1 if position_m > GUARD_NEUTRAL_M else -1


def disengage_under_torque(case: JudgedCommand) -> bool:
    """Row 10: the teeth of a main or splitter sleeve may be pulled out of mesh before the clutch's
    plates have surely parted, or while the brake loads them."""
    now_us, limits = float(case.seen.now_us), case.limits
    in_mesh_m = limits.contact_m - CLEAR_M
    out_us = [
        max(now_us, span.start_us + limits.teeth_out_us)
        for valve in limits.dogs
        if (span := case.spans[valve]) is not None and case.way_m(valve) < -in_mesh_m
    ] + [
        max(now_us, span.start_us + limits.sleeve_valve_us)
        for valve, way in ((SPLIT_LOW, -1), (SPLIT_HIGH, 1))
        if valve not in limits.splitter
        and (span := case.spans[valve]) is not None
        and case.seen.positions_m[SPLITTER] * way < -GUARD_NEUTRAL_M
    ]
    gauge_pa = case.seen.brake_pa - limits.atmosphere_pa
    return any(not case.is_parted(at_us) or gauge_pa > BRAKE_PRESSED_PA for at_us in out_us)


def actuation_at_low_supply(case: JudgedCommand) -> bool:
    """Row 11: a valve is newly driven at low supply pressure; one already driven may stay on, and
    what it has set going may be braked."""
    new = any(
        now is not None and before is None and not case.brakes(valve)
        for valve, (now, before) in enumerate(zip(case.spans, case.state.spans, strict=True))
    )
    return new and case.seen.supply_pa < case.limits.supply_low_pa


def output_before_the_self_test(case: JudgedCommand) -> bool:
    """Row 12: a valve is driven by a controller that is not armed, or before the self-test: all
    inputs valid in PROOF_STEPS consecutive steps, the sensor clock settled, and the guard's own
    limits sane."""
    ready = case.state.armed and case.state.proofs >= PROOF_STEPS
    return any(case.spans) and not ready


def gear_is_denied(state: GuardState, seen: GuardInputs) -> bool:
    """Whether the shafts say that a sleeve is not in the gear that it is measured in."""
    return seen.gear_is_wrong or any(gear.is_denied for gear in state.pulled)


def sensor_denies_a_gear(case: JudgedCommand) -> bool:
    """Row 13: both sleeves are measured in neutral, but a gear turns exactly with its sleeve, so it
    is taken to be in mesh. Brake, range and the other sleeve may not be driven then; the sleeve of
    that gear may. Or a sleeve is measured in its gear, but the shafts say that it is not: nobody
    knows where it is, and none may be driven."""
    if gear_is_denied(case.state, case.seen):
        return any(case.spans[valve] is not None for valve in MAIN_VALVES)
    if case.seen.agreeing == 0:
        return False
    sleeve = case.limits.main[case.seen.agreeing].sleeve
    others = [v for v in MAIN_VALVES if case.limits.main[v].sleeve != sleeve]
    return any(case.spans[v] is not None for v in (BRAKE, RANGE_LOW, RANGE_HIGH, *others))


def moved_without_a_request(case: JudgedCommand) -> bool:
    """Row 17: a sleeve set going though no gear is asked for that is not in already. One that
    stands before a gear's teeth may be brought back to neutral."""
    if all(case.brings_back(valve) for valve in case.starting()):
        return False
    wanted = case.state.wanted
    return wanted is None or case.seen.now_us - wanted[1] > case.limits.request_us


def back_and_forth(case: JudgedCommand) -> bool:
    """Row 18: splitter or range sent back sooner than a clutch opens and closes; not a sleeve with
    dog teeth, which is pulled to neutral and braked there. A time that lies ahead is of a sensor
    clock that has restarted since."""
    now_us, last_us = case.seen.now_us, case.state.group_us
    return any(
        0 <= now_us - last_us.get(OTHER_END[valve], -FOREVER_US) < case.limits.clutch_travel_us
        for valve in case.starting()
        if valve in OTHER_END and valve not in case.limits.splitter
    )


def timed_by_another_clock(case: JudgedCommand) -> bool:
    """Row 19: the clock that the commands are timed by is not the sensors' as the guard reads it
    from their stamps: a valve would open at another time than this command was judged for."""
    return any(case.spans) and abs(case.seen.clock_error_us) > CLOCK_ERROR_US


def stands_too_long(case: JudgedCommand) -> bool:
    """Row 20: a main sleeve has stood between neutral and a gear's teeth for too long, and anything
    is switched on that does not bring it back to neutral."""
    since_us, now_us = case.state.before_teeth_us.values(), case.seen.now_us
    if all(now_us - each_us <= case.limits.before_teeth_us for each_us in since_us):
        return False
    return any(
        span is not None and (was is None or was.start_us > now_us) and not case.brings_back(valve)
        for valve, (span, was) in enumerate(zip(case.spans, case.state.spans, strict=True))
    )


class GuardRow(NamedTuple):
    """One rule: its number in docs/guard.md, whether it latches, and the test."""

    number: int
    latches: bool
    forbids: Rule


GUARD_ROWS: Final = (
    GuardRow(12, False, output_before_the_self_test),
    GuardRow(19, False, timed_by_another_clock),
    GuardRow(1, True, both_valves_of_a_sleeve),
    GuardRow(2, True, two_sleeves_of_the_main_box),
    GuardRow(7, False, driven_too_long_or_blind),
    GuardRow(13, False, sensor_denies_a_gear),
    GuardRow(5, False, brake_against_the_driveline),
    GuardRow(6, False, brake_beyond_its_limits),
    GuardRow(8, False, range_change_out_of_neutral),
    GuardRow(9, False, input_overspeed),
    GuardRow(10, False, disengage_under_torque),
    GuardRow(4, False, engage_on_unknown_speed),
    GuardRow(3, False, slip_out_of_its_window),
    GuardRow(11, False, actuation_at_low_supply),
    GuardRow(17, False, moved_without_a_request),
    GuardRow(18, False, back_and_forth),
    GuardRow(20, False, stands_too_long),
)
"""In the order in which they are applied: the first rule that forbids is the one reported."""


class Guard:
    """Judges finished frames."""

    def __init__(self, limits: GuardLimits, armed: bool) -> None:
        """armed: whether valves may be driven at all; it cannot be changed later."""
        self._limits = limits
        self._state = GuardState(armed=armed)
        self._is_sound = limits.are_sane and _decodes_as_it_should()
        self.blocks = 0
        self.blocked_row: int | None = None
        self.gear_is_denied = False
        """Whether a sleeve is measured in a gear that it is not in, as of the newest step."""

    @property
    def is_proven(self) -> bool:
        """Whether the self-test is passed."""
        return self._state.proofs >= PROOF_STEPS

    @property
    def is_armed(self) -> bool:
        """Whether anything may be commanded, clutch and engine included."""
        return self._state.armed

    def passes(self, payload: bytes, seen: GuardInputs) -> bool:
        """Whether the frame may be sent. A latched guard passes only frames that drive no valve;
        such a frame clears the latch, since the sequence has then withdrawn its command."""
        state = self._state
        self._note(seen)
        wished = spans(decode(payload), state.spans, seen.now_us)
        if not any(wished):
            state.latched_by, self.blocked_row = 0, None
        elif state.latched_by:
            self.blocked_row = state.latched_by
        else:
            self.blocked_row = self._judge(JudgedCommand(wished, seen, state, self._limits))
        if self.blocked_row is not None:
            self.blocks += 1
            wished = NO_SPANS
        self._remember(wished, seen)
        return self.blocked_row is None

    def _judge(self, case: JudgedCommand) -> int | None:
        for row in GUARD_ROWS:
            if row.forbids(case):
                if row.latches:
                    self._state.latched_by = row.number
                return row.number
        return None

    def _note(self, seen: GuardInputs) -> None:
        """Self-test, the request and the brake's energy, from what is seen. With another sensor
        clock the self-test begins anew: how long its frames waited for the bus is not known yet."""
        state = self._state
        self._note_request(seen)
        note_sleeves(state, seen, self._limits)
        self.gear_is_denied = gear_is_denied(state, seen)
        if seen.clock_is_new:
            state.proofs = 0
        if state.proofs < PROOF_STEPS:
            proven = seen.valid and self._is_sound and seen.clock_gained_us <= SETTLED_US
            if not proven:
                state.proofs = 0
            elif seen.has_heard:
                state.proofs += 1
        layshaft = seen.speeds[LAYSHAFT]
        if state.judged_us is not None and layshaft is not None:
            gauge_pa = max(0.0, seen.brake_pa - self._limits.atmosphere_pa)
            torque = self._limits.brake_nm_per_pa * gauge_pa
            state.brake_j += torque * layshaft.omega_rad_s * (seen.now_us - state.judged_us) * 1e-6
        state.judged_us = seen.now_us

    def _note_request(self, seen: GuardInputs) -> None:
        """A request stands until its gear is in and the clutch is closed."""
        state, gear = self._state, seen.requested_gear
        if gear is not None and gear in self._limits.gear_at.values():
            state.wanted = (gear, seen.now_us)
        if state.wanted is not None and seen.clutch_closed >= CLUTCH_CLOSED_SHARE:
            in_mesh = JudgedCommand(NO_SPANS, seen, state, self._limits).gear_number()
            if seen.valid and in_mesh == state.wanted[0]:
                state.wanted = None

    def _remember(self, wished: Spans, seen: GuardInputs) -> None:
        state, now_us = self._state, seen.now_us
        case = JudgedCommand(wished, seen, state, self._limits)
        remember_drives(case)
        state.pulls = case.pulling()
        state.group_us |= {valve: now_us for valve in OTHER_END if wished[valve] is not None}
        was = state.spans[BRAKE]
        if was is not None and was.start_us <= now_us:
            state.brake_off_us = min(was.end_us, now_us)
        if wished[BRAKE] is None and was is None:
            state.brake_j = 0.0
        state.spans = wished


def _decodes_as_it_should() -> bool:
    """The self-test of the decoder: a frame that drives nothing and one that drives everything."""
    off, on = (False,) * VALVE_COUNT, (True,) * VALVE_COUNT
    nothing, everything = bytes(FRAME_LENGTH), b"\xff" * FRAME_LENGTH
    return decode(nothing).driven == off and decode(everything).driven == on
