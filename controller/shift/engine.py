"""What the engine is asked for: no torque before the clutch opens, speed in a downshift.

**Torque.** TSC1 asks for no torque; the engine follows in its own time, and says how far it is
(EEC1). The clutch sets off so early that its plates part when no more than
`engine.torque_left_percent` of the engine's reference torque is left. With a gear in mesh engine
and vehicle swing against each other on the shafts and tyres between them. A torque that is taken
away at once leaves the engine but not the twisted shafts. So on a driveline that has been seen to
ring it is planned what is asked of the engine until the plates part, between its own torque as it
was and the one with which it coasts along with the vehicle, that leaves shafts, wheels and tyres at
rest then: for several times until then, and the one is taken that costs least. Only the plan's
beginning is asked for; the next plan is made anew from what was seen since (model predictive
control; Rawlings, Mayne, Diehl 2017, ch. 1; taking a swing away by bounded torque: Singhose,
Singer, Seering 1994).

**Speed.** In a downshift the engine brings the layshaft above the new gear's speed (thesis 2.2):
the clutch closes, the engine gets a TSC1 speed request, the clutch opens again; from there the slip
falls as in an upshift. The same is done when a gear has become too slow before it was engaged.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.models.twist import Twist
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.context import FALL_US as SEEN_LATE_US
from meshpoint.controller.shift.context import SEQUENCE_CLUTCH_CLOSED_SHARE, ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.kernels.jit import compiled
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

LATER_S: Final = (0.0, 0.01, 0.02, 0.04, 0.07, 0.11, 0.17, 0.25, 0.4, 0.6)
"""The plates part so much later than they could: tried from the first."""
NEAR_S: Final = (-0.03, -0.02, -0.01, 0.0, 0.02)
"""About what was planned before."""
PIECES: Final = 6
"""A plan asks for no more torques than this, one after the other."""
MS_PER_NM: Final = 2.0
"""What is left in the shafts costs as much as a shift that takes this much longer (docs/decisions,
0036)."""
QUIET: Final = 1e-2
"""Nm left, for a Nm that is asked for beyond coasting: of equal plans the quieter one."""
CLOSE_NM: Final = 1e-4
"""Torques that move by no more are found."""
SWEEPS: Final = 2000
"""No search goes on for longer: of 700 in ramps of `typical` the longest took 1,322."""
MOST_NM: Final = 1e9
"""No driveline carries that."""

KNOWN_MS: Final = 400
"""What the shafts carry is waited for no longer: a gear is followed for `LEAST_S` before the
controller says it, and teeth may be lost meanwhile."""
BESIDE_SHARE: Final = 0.005
"""The guard allows for a step of the torque, a per cent, and rounding; half of a step is taken by
`owed_share`."""
TURNS_US: Final = 60 * MS_IN_US
"""The guard looks at the engine's speed for 50 ms of a request before it takes it to turn."""

SHORT_RAD_S: Final = 1.0
"""The slip may be this much less than asked for (10 rpm)."""
OVER_RAD_S: Final = 3.0
"""The slip may be this much more than asked for (30 rpm): the brake removes the surplus."""
CARRIED_RAD_S: Final = 1.5
"""Plates carry the layshaft with the engine where the gear's slip by its own speed and by the
engine's differ by less (15 rpm), but for their ages."""
OLDER_US: Final = 10 * MS_IN_US
"""So much older a shaft's speed is than the engine's, which EEC1 says: it is a mean over edges."""
NEAR_RAD_S: Final = 5.0
"""An engine that will be this near (50 rpm) to the speed that a gear needs is asked for it."""
HEARS_US: Final = 20 * MS_IN_US
"""So old are a measured acceleration and what a request changes of it together, beyond the
torque's own lag: a tick and the bus, there and back."""
OVERSHOOT: Final = 1.05
"""The engine may come to so much more than it is asked for (docs/safety.md)."""
MOST_SHARE: Final = 0.999
"""Of the input shaft's limit an engine is asked for no more: rounding adds to it."""
BEYOND_US: Final = 300 * MS_IN_US
"""For this long the speed that a gear needs may be above the input shaft's limit: a main shaft that
swings comes back, a vehicle that rolls downhill does not."""


class Band(NamedTuple):
    """The torque that is asked for."""

    least_nm: float
    most_nm: float


class Unloading(NamedTuple):
    """What is asked of the engine, and when the plates part."""

    torque_nm: float
    steps: int
    """Until the plates part."""
    left_nm: float
    """What stays in the driveline then, as a torque of the shafts."""


def unload(
    twist: Twist, band: Band, step_s: float, least: int, before: int | None
) -> Unloading | None:
    """The plan from here on; None where the driveline's figures lead nowhere finite. least: the
    steps that the clutch takes until its plates part; before: those which were planned last until
    then."""
    if before is None:
        later = {least + round(more_s / step_s) for more_s in LATER_S}
    else:
        later = {least} | {max(least, before + round(more_s / step_s)) for more_s in NEAR_S}
    paths = _Paths(twist, step_s, max(later))
    if not np.abs(paths.left).max() < MOST_NM:
        return None
    found, least_ms = None, np.inf
    for steps in sorted(later):
        waits_ms = 1e3 * step_s * (steps - least)
        if waits_ms >= least_ms:
            break
        plan = _plan(paths, steps, band, twist.coasting_nm)
        cost_ms = waits_ms + MS_PER_NM * plan.left_nm
        if cost_ms < least_ms:
            found, least_ms = plan, cost_ms
    return found


class _Paths:
    """Where the driveline goes by itself, and what a torque asked for adds."""

    def __init__(self, twist: Twist, step_s: float, most: int) -> None:
        moves = twist.within(step_s)
        paths = np.zeros((most + 1, len(moves), 2))
        paths[0, :-1, 0], paths[0, -1, 1] = twist.state, 1.0
        for k in range(most):
            paths[k + 1] = moves @ paths[k]
        self.left: Vector = twist.left_nm @ paths[:, :-1]
        self.free = self.left[:, :, 0]
        """What is left after n steps without a torque asked for (n, 5)."""
        self.added = self.left[:, :, 1]
        """What one adds for each Nm asked for in all of them (n, 5)."""


def _plan(paths: _Paths, steps: int, band: Band, coasting_nm: float) -> Unloading:
    """The torques, each for a share of the steps, that leave least."""
    ends = steps - np.unique(np.linspace(0, steps, min(PIECES, steps) + 1).round().astype(int))
    adds = (paths.added[ends[:-1]] - paths.added[ends[1:]]).T
    coasts = paths.free[steps] + coasting_nm * paths.added[steps]
    found = _least(adds, coasts, *(nm - coasting_nm for nm in band))
    return Unloading(
        coasting_nm + float(found[0]), steps, float(np.linalg.norm(coasts + adds @ found))
    )


def _least(adds: Vector, coasts: Vector, low: float, high: float) -> Vector:
    """The x within low and high that makes |adds x + coasts| least."""
    count = adds.shape[1]
    x: Vector = np.full(count, min(max(0.0, low), high))
    least_within(adds.T @ adds + QUIET**2 * np.eye(count), coasts @ adds, low, high, x)
    return x


@compiled
def least_within(matrix: Vector, slope: Vector, low: float, high: float, x: Vector) -> None:
    """Moves x (n,) to where x' matrix x / 2 + slope' x is least within low and high, one of x after
    the other (projected Gauss-Seidel; Hildreth, Naval Research Logistics Quarterly 4, 1957)."""
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(x.shape[0]):
            off = slope[i]
            for j in range(x.shape[0]):
                off += matrix[i, j] * x[j]
            there = min(max(x[i] - off / matrix[i, i], low), high)
            moved = max(moved, abs(there - x[i]))
            x[i] = there
        if moved < CLOSE_NM:
            return


def ramp_down(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Asks the engine for less torque; returns whether the clutch may set off: little enough will
    be left when its plates part, or the torque has taken as long as it may."""
    limits = context.settings.engine
    if limits.ramp_ms == 0 or not context.engine_carries(snapshot):
        return True
    if _is_soon_known(context, snapshot):
        return False
    clutch = context.sheet.clutch
    parting_s = clutch.open_delay_s * (1.0 - clutch.kiss_share)
    left = context.torque.left_in(parting_s)
    if left is None:
        return True  # an engine that does not say how far it is cannot be waited for
    if context.rings.twists and limits.swing_ramp_ms > 0 and snapshot.loaded is not None:
        twist = snapshot.loaded.twist(snapshot.now_us)
        is_over = None if twist is None else _unload(context, snapshot, twist, parting_s)
        if is_over is not None:
            return is_over or context.late(snapshot, limits.swing_ramp_ms)
    context.engine_share = 0.0
    if abs(left) <= limits.torque_left_share:
        return True
    return context.late(snapshot, limits.ramp_ms)


def _is_soon_known(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether what the shafts of a driveline that rings carry will be known in a moment. Soon after
    a gear was engaged they swing the most, also where the engine gives no torque. Where it may be
    the sensor that scatters, nothing is waited for."""
    shift, limits, loaded = context.running, context.settings.engine, snapshot.loaded
    is_planned = context.rings.is_beyond_noise and limits.swing_ramp_ms > 0 and shift.own_nm is None
    if not is_planned or loaded is None or shift.clutch_us is not None:
        return False
    return loaded.is_early and not context.late(snapshot, KNOWN_MS)


def _unload(
    context: ShiftContext, snapshot: StepSnapshot, twist: Twist, parting_s: float
) -> bool | None:
    """Asks for what the plan says; returns whether the clutch may set off, None without a plan."""
    shift, step_s = context.running, context.settings.timing.measured_us * US
    if shift.own_nm is None:
        shift.own_nm = (context.torque.share or 0.0) * context.sheet.engine.reference_nm
        shift.own_us = snapshot.now_us
    if shift.clutch_us is not None:
        parting_s -= (snapshot.now_us - shift.clutch_us) / SECOND_US
    least = max(1, math.floor(parting_s / step_s))
    is_seen = snapshot.now_us - shift.own_us >= TURNS_US
    turning_rad_s2 = context.torque.engine_rad_s2 if is_seen else 0.0
    band = _band(context, shift.own_nm, twist.coasting_nm, turning_rad_s2)
    plan = unload(twist, band, step_s, least, shift.unloads_in)
    if plan is None:
        return None
    shift.unloads_in = plan.steps
    _ask(context, plan.torque_nm)
    return plan.steps <= least


def _band(context: ShiftContext, own_nm: float, coasting_nm: float, turning_rad_s2: float) -> Band:
    """Between the engine's own torque, before any was taken away, and the one with which it coasts.
    Beyond none only as far as the engine needs to change its speed as it does: more would load the
    clutch anew, and row 14 of the guard forbids it. A plan that counted on more would wait for a
    torque that never comes."""
    engine = context.sheet.engine
    turning_nm = engine.inertia_kgm2 * turning_rad_s2
    beside_nm = BESIDE_SHARE * engine.reference_nm
    low_nm, high_nm = min(own_nm, 0.0, turning_nm), max(own_nm, 0.0, turning_nm)
    return Band(
        max(min(own_nm, coasting_nm), low_nm - beside_nm),
        min(max(own_nm, coasting_nm), high_nm + beside_nm),
    )


def _ask(context: ShiftContext, torque_nm: float) -> None:
    """Asks for a torque. TSC1 says it in the steps in which EEC1 does: what rounding leaves out is
    asked for with the next frames."""
    engine, shift, step = context.sheet.engine, context.running, context.torque.step
    owed = torque_nm / engine.reference_nm + shift.owed_share
    context.engine_share = step * round(owed / step)
    shift.owed_share = owed - context.engine_share


def too_slow(context: ShiftContext, snapshot: StepSnapshot) -> Trigger:
    """The gear is slower than its sleeve: asks for the engine, a limited number of times a
    shift. The gear then comes down from above anew, and may be braked as often as at first."""
    shift = context.running
    if shift.raises >= context.settings.limits.raises:
        return context.give_up(snapshot, FaultCode.SYNCHRONISE_FAILED)
    shift.raises += 1
    shift.pulses = 0
    shift.plan = shift.release_us = None
    context.all_off(snapshot.now_us)
    return Trigger.TOO_SLOW


def raise_speed(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Closes the clutch and asks the engine for speed, until the gear has the slip wanted."""
    context.clutch = ClutchAction.CLOSE
    wanted, carried = _raised_slip(context, snapshot), _carried_slip(context, snapshot)
    _ask_to_rise(context, wanted, snapshot)
    if carried is not None and _comes_to(context, carried, wanted, snapshot):
        return Trigger.RAISED
    if _stays_beyond(context, wanted, snapshot):
        return context.give_up(snapshot, FaultCode.INPUT_OVERSPEED)
    if context.late(snapshot, context.settings.limits.raise_ms):
        closed = (snapshot.view.clutch_closed or 0.0) >= SEQUENCE_CLUTCH_CLOSED_SHARE
        return context.give_up(
            snapshot, FaultCode.ENGINE_FAILED if closed else FaultCode.CLUTCH_STUCK
        )
    return None


def _carried_slip(context: ShiftContext, snapshot: StepSnapshot) -> float | None:
    """The gear's slip (rad/s) by the engine's speed, where the plates carry the layshaft with it;
    None where they do not, or a speed is not known. The layshaft's is the older one: it is behind
    by what the engine has gained since."""
    slip = snapshot.speeds.slip_rad_s(context.running.target.main)
    main, engine = snapshot.speeds.main, snapshot.engine_rad_s
    if slip is None or main is None or engine is None:
        return None
    by_engine = _gear_over_engine(context) * engine - main
    gained = _gear_over_engine(context) * context.torque.engine_rad_s2 * OLDER_US * US
    return by_engine if abs(by_engine - gained - slip) < CARRIED_RAD_S else None


def _comes_to(
    context: ShiftContext, slip_rad_s: float, wanted_rad_s: float, snapshot: StepSnapshot
) -> bool:
    """Whether the engine brings the gear from its slip to the one wanted by the time that the
    plates part, if the clutch is opened now. It changes the slower the nearer it is to what it was
    asked for."""
    clutch, lag_s = context.sheet.clutch, context.sheet.engine.lag_s
    meeting = max(0.0, (snapshot.view.clutch_closed or 0.0) - clutch.kiss_share)
    parting_s = meeting * clutch.open_delay_s + context.tick_us * US
    rate_rad_s2 = _gear_over_engine(context) * context.torque.engine_rad_s2
    comes = rate_rad_s2 * lag_s * (1.0 - math.exp(-parting_s / lag_s))
    over_rad_s = slip_rad_s + comes - wanted_rad_s
    # One that is too fast and still rises would only come to more.
    return over_rad_s >= -SHORT_RAD_S and (over_rad_s <= OVER_RAD_S or rate_rad_s2 > 0.0)


def _gear_over_engine(context: ShiftContext) -> float:
    """Speed of the new gear over the engine's, the clutch closed."""
    gear, sheet = context.running.target, context.sheet
    return sheet.main_mesh(gear.main).ratio * sheet.split_mesh(gear.split).ratio


def _ask_to_rise(context: ShiftContext, slip_rad_s: float, snapshot: StepSnapshot) -> bool:
    """Asks the engine for the speed at which the new gear has a slip (rad/s); returns whether it
    may turn so fast. Its own control creeps into a speed: it is asked for the most that it may,
    until what its torque still adds once it is taken away brings it near enough."""
    context.ask_engine(context.running.target, slip_rad_s, snapshot)
    wanted, engine = context.engine_rad_s, snapshot.engine_rad_s
    if wanted is None or engine is None:
        return wanted is not None
    runs_on_s = context.sheet.engine.lag_s + HEARS_US * US
    if engine + context.torque.engine_rad_s2 * runs_on_s < wanted - NEAR_RAD_S:
        context.engine_rad_s = context.sheet.limits.input_max_rad_s
    return True


def raise_ahead(context: ShiftContext, snapshot: StepSnapshot, *, stays_out: bool) -> None:
    """The engine rises for a gear that is too slow from when the old one is out of its teeth, so
    that it has come to its speed when the plates meet. They close as soon as the sleeves stay out:
    one that falls short takes 0.1 s more to neutral. Not for a sleeve that has left neutral, nor
    where the range changes the main shaft's speed before."""
    shift, view, target = context.running, snapshot.view, context.running.target
    slip = snapshot.speeds.slip_rad_s(target.main)
    is_too_slow = slip is not None and slip < context.settings.window.contact_low_rad_s
    closes = context.clutch is ClutchAction.CLOSE
    context.engine_rad_s, context.clutch = None, ClutchAction.OPEN
    if shift.returns or shift.changes_range or not is_too_slow:
        return
    if closes or view.clutch_parted:
        may_rise = _ask_to_rise(context, _raised_slip(context, snapshot), snapshot)
        is_only_main = view.split is target.split and view.range_ is target.range_
        if stays_out and is_only_main and may_rise:
            context.clutch = ClutchAction.CLOSE


def _stays_beyond(context: ShiftContext, slip_rad_s: float, snapshot: StepSnapshot) -> bool:
    """Whether the gear has been too fast for the input shaft for as long as a swing may last."""
    shift = context.running
    speed = context.engine_speed(shift.target, slip_rad_s, snapshot)
    if speed is None or speed <= context.sheet.limits.input_max_rad_s:
        shift.beyond_us = None
        return False
    if shift.beyond_us is None:
        shift.beyond_us = snapshot.now_us
    return snapshot.now_us - shift.beyond_us >= BEYOND_US


def part_clutch(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Opens the clutch; the engine holds its speed until the plates are apart."""
    context.clutch = ClutchAction.OPEN
    context.ask_engine(context.running.target, _raised_slip(context, snapshot), snapshot)
    if snapshot.view.clutch_parted:
        context.engine_rad_s = None
        context.board.off(ValveName.BRAKE)
        return Trigger.CLUTCH_OPEN
    if context.late(snapshot, context.settings.limits.clutch_ms):
        return context.give_up(snapshot, FaultCode.CLUTCH_STUCK)
    return None


def _raised_slip(context: ShiftContext, snapshot: StepSnapshot) -> float:
    """The slip (rad/s) to ask for: `aim_slip_rpm`, plus what drag takes from the earliest on that
    plates of the sheet's tolerance part until a sleeve that is fired once they are measured apart
    comes to its gear. The measurement comes up to a sensor read and a tick later. And what the
    brake is to take away."""
    sheet, target, window = context.sheet, context.running.target, context.settings.window
    ratio = sheet.main_mesh(target.main).ratio
    layshaft = snapshot.speeds.layshaft or 0.0
    drag_rad_s2 = snapshot.layshaft.drag_nm(layshaft) / sheet.inertia_kgm2(target.split)
    clutch, sleeve = sheet.clutch, sheet.sleeve
    earliest_share = clutch.kiss_share + clutch.kiss_tolerance
    parted_s = (earliest_share - clutch.surely_open_share) * clutch.open_delay_s
    fall_s = parted_s + SEEN_LATE_US * US
    ahead_us = snapshot.earliest_us - snapshot.now_us + context.tick_us
    stroke_s = ahead_us * US + sleeve.delay_s + sleeve.delay_limit_s
    least = window.aim_slip_rad_s + ratio * drag_rad_s2 * (fall_s + stroke_s)
    least = min(least, _most_slip(context, snapshot))
    return least + _braked_slip(context, least, snapshot)


def _most_slip(context: ShiftContext, snapshot: StepSnapshot) -> float:
    """The slip (rad/s) at which the input shaft turns as fast as it may; none where the gear itself
    is too fast."""
    speed = context.engine_speed(context.running.target, 0.0, snapshot)
    if speed is None:
        return math.inf
    left_rad_s = MOST_SHARE * context.sheet.limits.input_max_rad_s - speed
    return max(0.0, left_rad_s * _gear_over_engine(context))


def _braked_slip(context: ShiftContext, slip_rad_s: float, snapshot: StepSnapshot) -> float:
    """By how much more than a slip (rad/s) a gear is raised where the strategy aims: a pitch for
    each sleeve delay. The brake takes it away again, and by when it is released one gap or the next
    is met (`synchronise`). No more than the input shaft's limit leaves to an engine that
    overshoots; nothing where drag takes as much by itself, where a firing chooses the phase, nor
    after the range, whose main shaft swings on until the contact."""
    sheet, target = context.sheet, context.running.target
    most = sheet.dog.pitch_rad / sheet.sleeve.delay_s
    if context.running.changes_range:
        return 0.0
    if slip_rad_s - context.settings.window.aim_slip_rad_s > most:
        return 0.0
    speed = context.engine_speed(target, slip_rad_s, snapshot)
    if speed is None or not context.strategist.acting(context.reference_known(target.main)).aims:
        return 0.0
    left = (sheet.limits.input_max_rad_s / OVERSHOOT - speed) * _gear_over_engine(context)
    return max(0.0, min(left, most))
