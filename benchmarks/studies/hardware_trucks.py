"""The second half of study `hardware`: other valves, a parked sleeve, rings on the driven wheels.

Each is a campaign on the same drawn trucks as today's, with its intervals, and what it would risk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from benchmarks.studies.equipment import (
    Equipment,
    EquippedRun,
    EquippedShifts,
    with_stroke,
    with_valve_delay,
)
from benchmarks.studies.equipment_truth import Parking, WheelRingTeeth
from benchmarks.studies.record import (
    Chart,
    Given,
    Line,
    Panel,
    Statement,
    StudyJob,
    Style,
    Table,
    ThesisVerdict,
)
from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.spec import SEEDS_APART
from meshpoint.campaigns.summary import summarise
from meshpoint.controller.sleeve.cylinder import LAW
from meshpoint.controller.sleeve.law import SleeveLaw
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.gearbox import GearboxSheet, MainGear, load_sheet
from meshpoint.gearbox.tables import count, group, quantity, text
from meshpoint.rig_sim.settings import Profile
from meshpoint.units import MM, MS


@dataclass(frozen=True)
class Trucks:
    """The trucks, how many of them, and what the other equipment is like."""

    gearbox: str = text("gearbox")
    profile: str = text("profile", *Profile)
    gearboxes: int = count("gearboxes", 2, 10_000)
    shifts: int = count("shifts", 1, 1000)
    learning_shifts: int = count("learning_shifts", 0, 1000)
    """Of each gearbox, that do not count."""
    stroke_s: float = quantity("stroke_ms", 20.0, 100.0, MS)
    """Of the wide valve, from current to contact."""
    valve_delay_s: float = quantity("valve_delay_ms", 1.0, 12.0, MS)
    """Of the quick valve."""
    parking: Parking = group(Parking)
    rings: WheelRingTeeth = group(WheelRingTeeth)


class Offer(NamedTuple):
    """One piece of equipment, on its sheet."""

    equipment: Equipment
    sheet: GearboxSheet
    what: str
    risk: str


WIDE_RISK = (
    "the teeth meet faster and with more air behind them, so a miss strikes harder; a sleeve is "
    "past stopping before a step has seen it move; the pull that takes the old gear out more "
    "easily flies through neutral into the other gear's teeth, which turn 200 to 300 rpm faster; a "
    "larger valve, port and pipe, whose spool is as a rule slower; a leak, or a valve that stays "
    "open, has the sleeve in the teeth before the controller can answer"
)
QUICK_RISK = (
    "a small fast valve of industry, not proven in a gearbox's heat, oil, water and dirt, with a "
    "higher current and less force to break its spool free after a long rest; a false switch "
    "moves the sleeve sooner, and the guard has as much less time to withdraw it"
)
PARKED_RISK = (
    "a sleeve stands before turning teeth, held by friction alone, on every shift and while the "
    "brake works on them: a leaking valve, a shock of the road or a first stroke too far brings it "
    "in; worn friction holds it less, and the first stroke has to be learned. Here it is put there "
    "by the rig's truth, and its delay from there is the rig's own: finding the place costs "
    "nothing and never fails"
)
RINGS_RISK = (
    "two more sensors among water, salt and the brakes' heat, metres of cable and connectors at a "
    "sprung axle beside currents that couple into edges (EMC), and two more inputs that may fail "
    "and must be judged; rings are damaged, or changed with the hubs, and their teeth then learned "
    "anew. Here the wheels' speed is the rig's truth with the error of learned teeth, and no edge "
    "is ever lost"
)


def offers(trucks: Trucks) -> tuple[Offer, ...]:
    """Today's truck first."""
    sheet = load_sheet(trucks.gearbox)
    wide = with_stroke(sheet, trucks.stroke_s)
    quick = with_valve_delay(sheet, trucks.valve_delay_s)
    parking, rings = trucks.parking, trucks.rings
    return (
        Offer(Equipment.TODAY, sheet, "today's truck", ""),
        Offer(
            Equipment.WIDE_VALVE,
            wide,
            f"valves of {_conductance(wide):.2g} m3/(s Pa) instead of {_conductance(sheet):.2g}: "
            f"{_stroke(wide)}; today {_stroke(sheet)}",
            WIDE_RISK,
        ),
        Offer(
            Equipment.QUICK_VALVE,
            quick,
            f"valves that switch after {trucks.valve_delay_s / MS:g} ms instead of "
            f"{sheet.sleeve.valve_delay_s / MS:g}: {_stroke(quick)}; today {_stroke(sheet)}",
            QUICK_RISK,
        ),
        Offer(
            Equipment.PARKED_SLEEVE,
            sheet,
            f"sleeve parked {parking.before_teeth_m / MM:g} mm before the teeth (sd "
            f"{parking.scatter_m / MM:g} mm), then pushed",
            PARKED_RISK,
        ),
        Offer(
            Equipment.WHEEL_RINGS,
            sheet,
            f"rings of {rings.teeth} teeth on both driven wheels, edges known to "
            f"{rings.error_percent_of_pitch:g} % of a pitch",
            RINGS_RISK,
        ),
    )


def _conductance(sheet: GearboxSheet) -> float:
    """Of a valve's way in, by the controller's law and the sheet."""
    return float(SleeveLaw(sheet).sheet.view(LAW)["feed"][0, 0])


def _stroke(sheet: GearboxSheet) -> str:
    """A stroke from neutral by the sheet."""
    sleeves, gear = Sleeves(sheet), MainGear.FIRST
    stroke, last_us = sleeves.from_neutral(gear), sleeves.abort_after_us(gear)
    return (
        f"a stroke of {stroke.contact_us / 1e3:.0f} ms that meets the teeth at "
        f"{stroke.contact_speed_m_s:.2f} m/s and can be stopped until "
        f"{(stroke.contact_us - last_us) / 1e3:.0f} ms before that"
    )


def _run(given: Given[Any], offer: Offer, number: int) -> EquippedRun:
    trucks: Trucks = given.own.trucks
    return EquippedRun(
        offer.equipment,
        offer.sheet,
        SEEDS_APART * given.common.seed + number,
        trucks.learning_shifts,
        trucks.shifts,
        Profile(trucks.profile),
        trucks.parking,
        trucks.rings,
    )


def jobs(given: Given[Any]) -> tuple[StudyJob, ...]:
    """Every truck with every equipment."""
    trucks: Trucks = given.own.trucks
    return tuple(
        _run(given, offer, number) for offer in offers(trucks) for number in range(trucks.gearboxes)
    )


class Compared(NamedTuple):
    """What the equipment came to."""

    statements: tuple[Statement, ...]
    values: dict[str, Any]
    chart: Chart
    table: Table


def compared(given: Given[Any]) -> Compared:
    """Each beside today's truck."""
    trucks: Trucks = given.own.trucks
    every = offers(trucks)
    names = tuple(str(offer.equipment) for offer in every)
    records, more = [], {}
    for offer in every:
        found: list[EquippedShifts] = [
            given.results[_run(given, offer, number)] for number in range(trucks.gearboxes)
        ]
        own = [record for run in found for record in run.records]
        records += own
        more[str(offer.equipment)] = {
            "aborts": sum(run.aborts for run in found),
            "unmeant": sum(map(_is_unmeant, own)),
        }
    summary = summarise(Shifts.of(records), names)
    strategies = summary["strategies"]
    for name in names:
        strategies[name] |= more[name]
    today = names[0]
    statements = tuple(
        _statement(offer, strategies, summary["ratios"][f"{offer.equipment}/{today}"])
        for offer in every[1:]
    )
    columns = (
        "equipment", "shifts", "first in a gap", "95 %, from", "to", "after the ramp, ms",
        "p99, ms", "impact, J", "bounced off", "second attempts", "aborts", "unmeant contacts",
        "not engaged",
    )  # fmt: skip
    rows = tuple((name, *_row(strategies[name])) for name in names)
    title = (
        f"On {trucks.gearboxes} trucks of {trucks.gearbox}, profile {trucks.profile}; unmeant "
        "contacts came before the last firing"
    )
    return Compared(statements, summary, _chart(strategies), Table("trucks", title, columns, rows))


def _is_unmeant(record: JudgedShift) -> bool:
    """Whether the first contact came before the last firing: the sleeve flew through neutral as the
    old gear came out, or was not stopped by an abort."""
    met = record.contact is not None
    return met and (record.attempts == 0 or (record.delay_ms or 0.0) < 0.0)


def _row(found: dict[str, Any]) -> tuple[Any, ...]:
    gap, ramp = found["first_contact_gap"], found["after_ramp_ms"]
    return (
        found["shifts"], gap["rate"], *gap["ci95"], ramp["mean"], ramp["p99"],
        found["impact_j"]["mean"], found["bounced_off"], found["retries"], found["aborts"],
        found["unmeant"], found["not_engaged"],
    )  # fmt: skip


def _statement(offer: Offer, strategies: dict[str, Any], ratios: dict[str, Any]) -> Statement:
    ours, today = strategies[str(offer.equipment)], strategies[str(Equipment.TODAY)]
    over = ratios["first_contact_gap_rate"]
    return Statement(
        f"(1.3 asks what added hardware would allow) {offer.what}",
        f"{_said(ours)}; today's truck {_said(today)}; gaps over today's "
        f"{_figure(over['ratio'], '.3f')} ({_interval(over['ci95'], '.3f')})",
        ThesisVerdict.NOT_COMPARABLE,
        f"risk: {offer.risk}",
    )


def _said(found: dict[str, Any]) -> str:
    gap, impact = found["first_contact_gap"], found["impact_j"]
    return (
        f"{gap['rate']:.3f} ({_interval(gap['ci95'], '.3f')}) of {found['shifts']} first contacts "
        f"in a gap, {_figure(found['after_ramp_ms']['mean'], '.0f')} ms after the ramp, "
        f"{impact['mean']:.2f} J ({_interval(impact['mean_ci95'], '.2f')}), {found['aborts']} "
        f"aborts, {found['unmeant']} unmeant contacts, {found['not_engaged']} not engaged"
    )


def _interval(ends: list[float | None], form: str) -> str:
    return " to ".join(_figure(end, form) for end in ends)


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _chart(strategies: dict[str, Any]) -> Chart:
    numbers = list(range(1, len(strategies) + 1))
    every = list(strategies.values())

    def bars(name: str, values: list[float]) -> tuple[Line, ...]:
        return (Line(name, numbers, values, Style.BARS),)

    gaps = [100.0 * each["first_contact_gap"]["rate"] for each in every]
    ramps = [each["after_ramp_ms"]["mean"] for each in every]
    return Chart(
        "equipment",
        "What other valves, a parked sleeve and rings on the wheels would buy",
        "",
        (
            Panel("first contact in a gap, %", bars("closed loop", gaps), y_range=(0.0, 100.0)),
            Panel("after the torque ramp, ms", bars("closed loop", ramps)),
        ),
        x_names=tuple(strategies),
    )
