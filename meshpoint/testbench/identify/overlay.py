"""What was identified as a data sheet: a TOML file that names a sheet and what is other than there.

`based_on` names the sheet that it stands on (`meshpoint.gearbox.sheet`), so that the file holds
nothing but what the log has reported.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.table_text import number, quoted
from meshpoint.testbench.identify.identified import Identified

LEAST_SPREAD_MS: Final = 0.1


class Entry(NamedTuple):
    """A key of the sheet, its new value, and where it comes from."""

    table: str
    key: str
    value: float
    why: str


def entries(found: Identified, sheet: GearboxSheet) -> list[Entry]:
    """The keys that the log has reported, in the units of the file."""
    reported = {figure.name: figure.value for figure in found.figures if figure.value is not None}
    made = []

    def add(table: str, key: str, value: float | None, why: str) -> None:
        if value is not None:
            made.append(Entry(table, key, value, why))

    rpm = found.omega_ref_rad_s * 30.0 / 3.141592653589793
    add("brake", "max_torque_nm", reported.get("brake torque"), f"at {rpm:.0f} rpm of the layshaft")
    delays = _mean(reported, "brake valve on delay", "brake valve off delay")
    add("brake", "valve_delay_ms", delays, "mean of on and off")
    times = _mean(reported, "brake filling time", "brake emptying time")
    add("brake", "time_constant_ms", times, "63 % of the way, mean of filling and emptying")
    ratio = reported.get("inertia ratio")
    if ratio is not None:
        layshaft = sheet.shafts.layshaft_inertia_kgm2
        add("shafts", "input_inertia_kgm2", ratio * layshaft, "over the sheet's layshaft_inertia")
    drag = reported.get("drag")
    if drag is not None and found.omega_ref_rad_s > 0.0:
        viscous = max(drag / found.omega_ref_rad_s, 0.0)
        add("shafts", "friction_nms", viscous, f"the whole drag at {rpm:.0f} rpm over the speed")
    _sleeve(reported, made)
    kiss = reported.get("clutch kiss point")
    if kiss is not None:
        figure = found.figure("clutch kiss point")
        add("clutch", "kiss_percent", kiss, "")
        if figure.low is not None and figure.high is not None:
            half = 0.5 * (figure.high - figure.low)
            add("clutch", "kiss_tolerance_percent", half, "half the 95 % interval")
    for wheel in ("layshaft", "main"):
        add(f"wheels.{wheel}", "duty_percent", reported.get(f"{wheel} wheel duty"), "")
    return made


def _mean(reported: dict[str, float], *names: str) -> float | None:
    values = [reported[name] for name in names if name in reported]
    return sum(values) / len(values) if values else None


def _sleeve(reported: dict[str, float], made: list[Entry]) -> None:
    """The delay at the sheet's supply pressure, mean of all gears, and its spread."""
    delay = _mean(reported, *(f"sleeve delay {gear.name.lower()}" for gear in MAIN_GEARS))
    if delay is None:
        return
    made.append(
        Entry(
            "sleeve",
            "delay_ms",
            delay,
            "mean of the gears, at the sheet's supply pressure",
        )
    )
    spread = reported.get("sleeve delay spread")
    if spread is not None:
        value = max(spread, LEAST_SPREAD_MS)
        made.append(Entry("sleeve", "delay_sd_ms", value, "within a gear"))


def overlay(found: Identified, sheet: GearboxSheet, based_on: str, source: str) -> str:
    """The file's text. based_on: how the sheet is named; source: what was identified from."""
    lines = [
        f"# Identified by meshpoint from {source}.",
        "# What is not here is as in the data sheet that it is based on.",
        f"based_on = {quoted(based_on)}",
        f"name = {quoted(f'{sheet.name}, identified')}",
    ]
    table = ""
    for entry in entries(found, sheet):
        if entry.table != table:
            table = entry.table
            lines += ["", f"[{table}]"]
        why = f"    # {entry.why}" if entry.why else ""
        lines.append(f"{entry.key} = {number(entry.value, 5)}{why}")
    return "\n".join(lines) + "\n"
