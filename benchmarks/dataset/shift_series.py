"""What one shift's frames say, as columns: a dictionary of lists for each table of the set.

All times are microseconds of the sensor clock since the shift was requested. `arrival_us` is when
the sample's frame had reached the controller: what counts as known at a time is what had arrived by
then, not what had been sampled. The bus and the sensor clock are tied by the shortest way a frame
took; as that way itself cannot be seen, each arrival is put MARGIN_US later than it looks, which
is more than any first frame of a read takes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from benchmarks.dataset.recording import Recorded
from meshpoint.bridges.sample_clock import Chained, ties_of
from meshpoint.bridges.series import Sample, TimeSeries
from meshpoint.dbc.edges import EDGES as EDGES_OF_WHEEL
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import ValveAction
from meshpoint.dbc.sensor_time import LOW, unwrap
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import BAR, DEG, MM, RPM, US

MARGIN_US: Final = 1_000
BEFORE_US: Final = 400_000
"""In the old gear, before the request."""
AFTER_US: Final = 100_000
"""In the new gear, after the shift's end."""
KM_H, KELVIN = 1 / 3.6, 273.15
EDGES: Final = {
    message.__name__: (wheel, edge)
    for wheel, both in EDGES_OF_WHEEL.items()
    for edge, message in both._asdict().items()
}
SLEEVES: Final = {
    "sleeve_first_second_m": "first_second",
    "sleeve_crawl_third_m": "crawl_third",
    "sleeve_splitter_m": "splitter",
    "sleeve_range_m": "range",
}
VALVES: Final = (
    "brake", "split_low", "split_high", "main_first", "main_second", "main_crawl", "main_third",
    "range_low", "range_high",
)  # fmt: skip
Columns = dict[str, list[Any]]


class Clock(NamedTuple):
    """From the bus and the sensor clock to the shift's own time."""

    offset_s: float
    """The bus's time less the sensor clock's, at least."""
    zero_us: int
    """The sensor clock at the request, unwrapped."""

    def arrival_us(self, bus_us: int) -> int:
        """When a frame had come for certain."""
        return math.ceil(bus_us - self.offset_s / US) + MARGIN_US - self.zero_us

    def sampled_us(self, sensor_s: float) -> int:
        """When a sample was taken."""
        return round(sensor_s / US) - self.zero_us

    def stamped_us(self, stamp: int) -> int:
        """The same of a 32-bit stamp."""
        return unwrap(stamp, self.zero_us) - self.zero_us


class _Tied:
    """The axis is the sensor clock itself."""

    def offset_s(self, stamp: Chained) -> float:  # noqa: ARG002
        return 0.0


def clock_of(recorded: Recorded) -> Clock:
    """Both clocks, from all frames of the shift."""
    entries = [(bus_us * US, frame) for bus_us, frame in recorded.frames]
    offset_s = ties_of(entries, lambda frame: (frame,)).offset_s(Chained(0, 0.0, begins=True))
    near = round((entries[0][0] - offset_s) / US)
    return Clock(offset_s, unwrap(recorded.row.request_us, near))


def samples_of(recorded: Recorded, clock: Clock) -> Iterator[tuple[int, Sample]]:
    """Every sample of the shift's window with its frame's arrival; a sample's own time in s of the
    sensor clock. The frames before the window are taken too: the sensor clock may wrap there."""
    series = TimeSeries(_Tied())
    end_us = clock.stamped_us(recorded.row.end_us) + AFTER_US
    for bus_us, frame in recorded.frames:
        samples = list(series.take(bus_us * US - clock.offset_s, frame))
        arrival_us = clock.arrival_us(bus_us)
        if arrival_us > end_us:
            break
        if arrival_us >= -BEFORE_US:
            yield from ((arrival_us, sample) for sample in samples)


class ShiftSeries:
    """Gathers the tables of a shift."""

    def __init__(self, recorded: Recorded, clock: Clock) -> None:
        self._clock = clock
        self._phase = f"phase_{DRIVE_GEARS[recorded.row.to].main.name.lower()}_rad"
        self._newest: dict[str, int] = {}
        self.tables: dict[str, Columns] = {}
        for arrival_us, sample in samples_of(recorded, clock):
            self._take(arrival_us, sample)
        self._orders(recorded)

    def _take(self, arrival_us: int, sample: Sample) -> None:
        topic, at_us = sample.topic, self._clock.sampled_us(sample.time_s)
        times = {"time_us": at_us, "arrival_us": arrival_us}
        if topic in EDGES:
            self._edge(times, topic, sample.values)
        elif topic in ("SleevesMain", "SleevesAux"):
            for name, sleeve in SLEEVES.items():
                if name in sample.values:
                    position_mm = _over(sample.values[name], MM)
                    self._row("sleeves", times, sleeve=sleeve, position_mm=position_mm)
        elif topic in MAKERS:
            table, values = MAKERS[topic]
            self._row(table, times, **values(sample.values))
        elif topic == "ReferencePhase":
            self._true_phase(at_us, sample.values)
        elif topic == "ReferenceEncoder":
            speed_rpm = _over(sample.values["speed_rad_s"], RPM)
            self._row("true_layshaft", {"time_us": at_us}, layshaft_speed_rpm=speed_rpm)

    def _edge(self, times: dict[str, int], topic: str, values: dict[str, Any]) -> None:
        shaft, edge = EDGES[topic]
        before = self._newest.get(topic, int(values["newest_index"]))
        index = before + ((int(values["newest_index"]) - before) & LOW)
        self._newest[topic] = index
        self._row("edges", times, shaft=shaft, edge=edge, index=index)

    def _true_phase(self, at_us: int, values: dict[str, Any]) -> None:
        self._row(
            "true_phase",
            {"time_us": at_us},
            phase_deg=_over(values[self._phase], DEG),
            main_speed_rpm=_over(values["main_speed_rad_s"], RPM),
            road_speed_km_h=_over(values["road_speed_m_s"], KM_H),
        )

    def _orders(self, recorded: Recorded) -> None:
        """What the controller sent to valves, clutch and as its plan: fields with times of their
        own, which a `Sample` has as bare numbers."""
        names = {CODECS[name].spec.can_id: name for name in ORDERS}
        before: dict[str, tuple[str, int | None]] = {}
        for bus_us, frame in recorded.frames:
            name, arrival_us = names.get(frame.can_id), self._clock.arrival_us(bus_us)
            if name is not None and arrival_us >= -BEFORE_US:
                message = _message(name, frame)
                times = {"arrival_us": arrival_us}
                if name == "ReferenceEngagement":
                    self._event(message)
                elif name == "ShiftPrediction":
                    self._plan(times, message)
                else:
                    self._commands(times, name, message, before)

    def _commands(
        self, times: dict[str, int], name: str, message: Any, before: dict[str, Any]
    ) -> None:
        orders = _valves(message) if name == "ValveCommand" else {"clutch": (message.action, 0)}
        for valve, (action, stamp) in orders.items():
            is_planned = action in (ValveAction.OFF_AT, ValveAction.ON_AT) and valve != "clutch"
            at_us = self._clock.stamped_us(stamp) if is_planned else None
            if before.get(valve) != (action.name, at_us):
                before[valve] = action.name, at_us
                of = {"valve": valve, "action": action.name.lower(), "switch_us": at_us}
                self._row("commands", times, **of)

    def _plan(self, times: dict[str, int], message: Any) -> None:
        has_contact = message.contact_time_us != 0
        self._row(
            "predictions",
            {"time_us": self._clock.stamped_us(message.decision_time_us), **times},
            decision=message.decision.name.lower(),
            contact_us=self._clock.stamped_us(message.contact_time_us) if has_contact else None,
            phase_deg=message.phase_rad / DEG,
            phase_sd_deg=message.phase_sd_rad / DEG,
            slip_rpm=message.slip_rad_s / RPM,
        )

    def _event(self, message: Any) -> None:
        self._row(
            "true_events",
            {"time_us": self._clock.stamped_us(message.event_time_us)},
            event=message.event.name.lower(),
            gear=message.gear.name.lower(),
            phase_deg=message.phase_rad / DEG,
            slip_rpm=message.slip_rad_s / RPM,
            impact_j=message.impact_energy_j,
        )

    def _row(self, table: str, times: dict[str, int], **values: Any) -> None:
        columns = self.tables.setdefault(table, {})
        for name, value in (times | values).items():
            columns.setdefault(name, []).append(value)


ORDERS: Final = ("ValveCommand", "ClutchCommand", "ShiftPrediction", "ReferenceEngagement")


def _message(name: str, frame: Frame) -> Any:
    return read_alone(CODECS[name], frame)


def _valves(message: Any) -> dict[str, tuple[Any, int]]:
    of = message._asdict()
    return {valve: (of[f"{valve}_action"], of[f"{valve}_time_us"]) for valve in VALVES}


def _over(value: Any, unit: float) -> float | None:
    return None if value is None else value / unit


def _pressures(of: dict[str, Any]) -> dict[str, Any]:
    return {
        "brake_pressure_bar": _over(of["brake_pressure_pa"], BAR),
        "supply_pressure_bar": _over(of["supply_pressure_pa"], BAR),
        "oil_temperature_c": of["oil_temperature_k"] - KELVIN,
        "clutch_closed_percent": _over(of["clutch_position_fraction"], 0.01),
    }


def _valve_states(of: dict[str, Any]) -> dict[str, Any]:
    return {f"{valve}_on": bool(of[f"{valve}_energised"]) for valve in VALVES}


def _engine(of: dict[str, Any]) -> dict[str, Any]:
    return {
        "engine_speed_rpm": _over(of["engine_speed_rad_s"], RPM),
        "engine_torque_percent": _over(of["actual_engine_torque_fraction"], 0.01),
    }


def _estimates(of: dict[str, Any]) -> dict[str, Any]:
    return {
        "layshaft_angle_deg": of["layshaft_angle_rad"] / DEG,
        "layshaft_speed_rpm": of["layshaft_speed_rad_s"] / RPM,
        "layshaft_speed_sd_rpm": of["layshaft_speed_sd_rad_s"] / RPM,
        "layshaft_valid": bool(of["layshaft_valid"]),
        "main_angle_deg": of["main_angle_rad"] / DEG,
        "main_speed_rpm": of["main_speed_rad_s"] / RPM,
        "main_speed_sd_rpm": of["main_speed_sd_rad_s"] / RPM,
        "main_valid": bool(of["main_valid"]),
        "slip_rpm": of["slip_rad_s"] / RPM,
        "phase_deg": of["phase_rad"] / DEG,
        "phase_sd_deg": of["phase_sd_rad"] / DEG,
        "phase_known": bool(of["phase_known"]),
        "model_valid": bool(of["model_valid"]),
    }


MAKERS: Final = {
    "GearboxSensors": ("pressures", _pressures),
    "ValveStatus": ("valves", _valve_states),
    "EEC1": ("engine", _engine),
    "ControllerEstimates": ("estimates", _estimates),
}
"""Topics whose rows become rows of a table."""
