"""Whether pressures, temperature, sleeves, clutch and valves look like those of a gearbox at rest
or in gear: against the data sheet, with room for tolerances."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from meshpoint.commission.finding import Finding, Verdict
from meshpoint.controller.settings.valve_name import energised
from meshpoint.dbc.messages import (
    EEC1,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.logs.heard import Heard
from meshpoint.units import BAR, MM, RPM

GROUP: Final = "sensors"
SUPPLY_SHARE: Final = (0.6, 1.3)
"""Of the data sheet's supply, gauge: a compressor cuts in and out within this."""
SENSOR_END_PA: Final = 13.1e5
"""Pressure sensors saturate here."""
RELEASED_PA: Final = 0.3e5
"""A brake that is released is within this of the air around."""
OIL_C: Final = (-40.0, 150.0)
BEYOND_M: Final = 1.5 * MM
"""By which a position may lie beyond the stroke: mounting and calibration."""
CELSIUS: Final = 273.15


def judge_sensors(heard: Heard, sheet: GearboxSheet) -> Iterator[Finding]:
    """A finding for each sensor that was heard; messages that are missing are reported
    elsewhere."""
    sensors = heard.last(GearboxSensors)
    valves = heard.last(ValveStatus)
    if sensors is not None:
        driven = valves is not None and valves.brake_energised
        yield _supply(sensors, sheet)
        yield _brake(sensors, sheet, driven)
        yield _within("oil", sensors.oil_temperature_k - CELSIUS, OIL_C, "deg C")
        yield _within("clutch", 100.0 * sensors.clutch_position_fraction, (0.0, 100.0), "% closed")
    main, aux = heard.last(SleevesMain), heard.last(SleevesAux)
    if main is not None:
        yield _sleeve("first/second", main.sleeve_first_second_m, main.sensor_fault & 1, sheet)
        yield _sleeve("crawl/third", main.sleeve_crawl_third_m, main.sensor_fault & 2, sheet)
    if aux is not None:
        yield _sleeve("splitter", aux.sleeve_splitter_m, aux.sensor_fault & 1, sheet)
        yield _sleeve("range", aux.sleeve_range_m, aux.sensor_fault & 2, sheet)
    if valves is not None:
        yield _valves(valves)
    engine = heard.last(EEC1)
    if engine is not None:
        yield _engine(engine, sheet)


def _supply(sensors: GearboxSensors, sheet: GearboxSheet) -> Finding:
    gauge_pa = sensors.supply_pressure_pa - sheet.air.atmosphere_pa
    text = f"{gauge_pa / BAR:.2f} bar gauge, the sheet has {sheet.air.supply_gauge_pa / BAR:g}"
    low, high = (share * sheet.air.supply_gauge_pa for share in SUPPLY_SHARE)
    if sensors.supply_pressure_pa >= SENSOR_END_PA:
        return _bad("supply", f"{text}: the sensor is at its end")
    if not low <= gauge_pa <= high:
        return _bad("supply", f"{text}: no air, a wrong scale, or another gearbox's sheet")
    return _good("supply", text)


def _brake(sensors: GearboxSensors, sheet: GearboxSheet, driven: bool) -> Finding:
    gauge_pa = sensors.brake_pressure_pa - sheet.air.atmosphere_pa
    text = f"{gauge_pa / BAR:.2f} bar gauge, its valve {'driven' if driven else 'off'}"
    if not driven and abs(gauge_pa) > RELEASED_PA:
        return _bad("brake pressure", f"{text}: the brake drags, or the sensor is off")
    return _good("brake pressure", text)


def _sleeve(
    name: str, samples_m: tuple[float, ...], is_faulty: int, sheet: GearboxSheet
) -> Finding:
    text = f"{samples_m[0] / MM:+.2f} mm"
    if is_faulty:
        return _bad(f"sleeve {name}", f"{text}: the sensor says that it is out of range")
    if max(map(abs, samples_m)) > sheet.sleeve.stroke_m + BEYOND_M:
        return _bad(
            f"sleeve {name}", f"{text}, the stroke is {sheet.sleeve.stroke_m / MM:g} mm either way"
        )
    return _good(f"sleeve {name}", text)


def _valves(valves: ValveStatus) -> Finding:
    driven = [valve.name.lower() for valve in energised(valves)]
    return Finding(
        GROUP, "valves", Verdict.NOTE if driven else Verdict.GOOD,
        f"driven: {', '.join(driven)}" if driven else "all off",
    )  # fmt: skip


def _engine(engine: EEC1, sheet: GearboxSheet) -> Finding:
    rad_s = engine.engine_speed_rad_s
    if rad_s is None:
        return _bad("engine", "EEC1 reports no speed")
    text = f"{rad_s / RPM:.0f} rpm"
    if rad_s > sheet.limits.input_max_rad_s:
        return _bad("engine", f"{text}, the sheet allows {sheet.limits.input_max_rad_s / RPM:.0f}")
    return _good("engine", text)


def _within(name: str, value: float, allowed: tuple[float, float], unit: str) -> Finding:
    low, high = allowed
    text = f"{value:.1f} {unit}"
    if low <= value <= high:
        return _good(name, text)
    return _bad(name, f"{text}, plausible are {low:g} to {high:g}")


def _good(subject: str, text: str) -> Finding:
    return Finding(GROUP, subject, Verdict.GOOD, text)


def _bad(subject: str, text: str) -> Finding:
    return Finding(GROUP, subject, Verdict.BAD, text)
