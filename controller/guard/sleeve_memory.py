"""What the guard keeps of the main sleeves: how each was driven since it stood last, from where it
was set going, and since when it stands before a gear's teeth."""

from __future__ import annotations

from meshpoint.controller.guard.case import GuardState, JudgedCommand
from meshpoint.controller.guard.limits import GUARD_NEUTRAL_M, LEAVING_M_S, SPLITTER, GuardLimits
from meshpoint.controller.guard.view import GuardInputs


def note_sleeves(state: GuardState, seen: GuardInputs, limits: GuardLimits) -> None:
    """Before a command is judged: which main sleeves stand, and which of them between neutral and a
    gear. A time of another clock is taken to be now."""
    now_us = seen.now_us
    if seen.clock_is_new:
        state.before_teeth_us = dict.fromkeys(state.before_teeth_us, now_us)
        state.drives = {valve: each.ending_at(now_us) for valve, each in state.drives.items()}
        for gear in state.pulled:
            gear.restart()
    if not seen.valid:
        return
    for sleeve in limits.dog_sleeves:
        mine = limits.valves_of[sleeve]
        ends_us = [state.drives[valve].end_us for valve in mine if valve in state.drives]
        is_shut = all(
            seen.positions_us >= end_us + limits.valve_between_us[1] for end_us in ends_us
        )
        stands = is_shut and abs(seen.means_m_s[sleeve]) < LEAVING_M_S
        _note_pulled(state, seen, limits, sleeve, stands=stands)
        if stands:
            for valve in mine:
                drive = state.drives.pop(valve, None)
                way_m = seen.positions_m[sleeve] * limits.dogs[valve].direction
                if drive is None or way_m > GUARD_NEUTRAL_M:
                    continue
                if drive.pulls:
                    longest_us = max(drive.driven_us, state.withstood_us.get(valve, 0))
                    state.withstood_us[valve] = longest_us
                elif drive.stood_m < -GUARD_NEUTRAL_M:
                    state.pushes[valve] = drive
        if not GUARD_NEUTRAL_M < abs(seen.positions_m[sleeve]) <= limits.contact_m:
            state.before_teeth_us.pop(sleeve, None)
        elif not any(state.spans[valve] for valve in mine):
            state.before_teeth_us.setdefault(sleeve, now_us)


def _note_pulled(
    state: GuardState, seen: GuardInputs, limits: GuardLimits, sleeve: int, *, stands: bool
) -> None:
    """A gear of the main box that is pulled, or was and is still measured in."""
    if sleeve == SPLITTER:
        return
    gear = state.pulled[sleeve]
    if abs(seen.positions_m[sleeve]) <= limits.in_mesh_m:
        gear.forget()
    elif state.pulls.intersection(limits.valves_of[sleeve]):
        gear.pull(seen.now_us, seen.gear_rad)
    elif stands:
        gear.stands(seen.now_us, seen.gear_rad, limits.free_rad)


def remember_drives(case: JudgedCommand) -> None:
    """Once a command has passed: which main valves have gone off, and from where those that are on
    set their sleeves going."""
    state, stood_m = case.state, {}
    for valve in case.limits.dogs:
        span, way_m = case.spans[valve], case.way_m(valve)
        if span is not None:
            known_m = state.stood_m.get(valve, way_m)
            stood_m[valve] = way_m if case.has_not_set_off(span) else known_m
        if (drive := case.drive_before(valve)) is not None:
            state.drives[valve] = drive
    state.stood_m = stood_m
    state.engages = frozenset(valve for valve, _ in case.engaging())
