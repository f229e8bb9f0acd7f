"""What was identified as a data sheet: a TOML file that names a sheet and what is other than there.

`based_on` names the sheet that it stands on (`meshpoint.gearbox.sheet`), so that the file holds
nothing but what the log has reported.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.table_text import number, quoted
from meshpoint.identify.identified import Identified
from meshpoint.units import RPM

LEAST_SPREAD_MS: Final = 0.1


class Entry(NamedTuple):
    """A key of the sheet, its new value, and where it comes from."""

    table: str
    key: str
    value: float
    why: str
    low: float | None = None
    high: float | None = None
    """Ends of the 95 % interval; None where the value is a whole number, or a tolerance itself."""

    @property
    def interval(self) -> str:
        """In words; empty without one."""
        if self.low is None or self.high is None:
            return ""
        return f"{self.low:.4g} to {self.high:.4g}"


def entries(found: Identified, sheet: GearboxSheet) -> list[Entry]:
    """The keys that the log has reported, in the units of the file."""
    reported = {one.name: one for one in found.figures if one.value is not None}
    made: list[Entry] = []

    def add(
        table: str, key: str, names: tuple[str, ...], why: str, factor: float = 1.0,
        least: float = -math.inf,
    ) -> None:  # fmt: skip
        """The mean of these figures, of those that were reported. Their intervals' halves are
        averaged too: they may err the same way."""
        figures = [reported[name] for name in names if name in reported]
        value, low, high = (
            _mean([getattr(one, end) for one in figures], factor, least)
            for end in ("value", "low", "high")
        )
        if value is not None:
            made.append(Entry(table, key, value, why, low, high))

    rpm = found.omega_ref_rad_s / RPM
    add("brake", "max_torque_nm", ("brake torque",), f"at {rpm:.0f} rpm of the layshaft")
    delays = "brake valve on delay", "brake valve off delay"
    add("brake", "valve_delay_ms", delays, "mean of on and off")
    times = "brake filling time", "brake emptying time"
    why = "63 % of the way, mean of filling and emptying"
    add("brake", "time_constant_ms", times, why)
    layshaft = sheet.shafts.layshaft_inertia_kgm2
    why = "over the sheet's layshaft_inertia"
    add("shafts", "input_inertia_kgm2", ("inertia ratio",), why, layshaft)
    if found.omega_ref_rad_s > 0.0:
        why = f"the whole drag at {rpm:.0f} rpm over the speed"
        add("shafts", "friction_nms", ("drag",), why, 1.0 / found.omega_ref_rad_s, 0.0)
    gears = tuple(f"sleeve delay {gear.name.lower()}" for gear in sheet.dog_gears)
    before = len(made)
    add("sleeve", "delay_ms", gears, "mean of the gears, at the sheet's supply pressure")
    if len(made) > before:
        spread = ("sleeve delay spread",)
        add("sleeve", "delay_sd_ms", spread, "within a gear", least=LEAST_SPREAD_MS)
    add("clutch", "kiss_percent", ("clutch kiss point",), "")
    kiss = reported.get("clutch kiss point")
    if kiss is not None and kiss.low is not None and kiss.high is not None:
        half = 0.5 * (kiss.high - kiss.low)
        made.append(Entry("clutch", "kiss_tolerance_percent", half, "half the 95 % interval"))
    for wheel in ("layshaft", "main"):
        add(f"wheels.{wheel}", "duty_percent", (f"{wheel} wheel duty",), "")
    return made


def _mean(values: list[float | None], factor: float, least: float) -> float | None:
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        return None
    return max(factor * sum(known) / len(known), least)


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
        words = [word for word in (entry.interval, entry.why) if word]
        why = f"    # {'; '.join(words)}" if words else ""
        lines.append(f"{entry.key} = {number(entry.value, 5)}{why}")
    return "\n".join(lines) + "\n"
