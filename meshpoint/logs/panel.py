"""The state of a bus as a picture of 80 x 24 characters, drawn from what was heard last."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Final

from rich.text import Text

from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import (
    EEC1,
    ETC1,
    TC1,
    ControllerEstimates,
    ControllerStatus,
    FaultCode,
    GearboxSensors,
    Message,
    ReferenceEngagement,
    ShiftOutcome,
    ShiftPrediction,
    ShiftResult,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.kinematics import wrap_to_pitch
from meshpoint.logs.heard import Heard
from meshpoint.logs.story import CYCLIC, Line, Story
from meshpoint.results.road_speed import span_us
from meshpoint.results.rows import CONTACT_KINDS
from meshpoint.results.states import state_words
from meshpoint.units import BAR, DEG, RPM

WIDTH: Final = 80
HEIGHT: Final = 24
PHASE_CELLS: Final = 61
"""Characters over one pitch, an odd number: the middle of the gap has one of its own."""
TRAVEL_CELLS: Final = 9
LAST_LINES: Final = 5
LAST_SHIFTS: Final = 3
BUS_COLUMNS: Final = 3
SHORT: Final = (
    ("Reference", "Ref"), ("Controller", "Ctrl"), ("Propeller", "Prop"), ("Layshaft", "Lay"),
)  # fmt: skip
REPORTED: Final = ("driver", "controller", "truth", "bus", "bench")
"""Whose lines are shown: valves have a row of their own."""


class Panel:
    """Takes frames in bus order and draws what it knows at any time.

    sheet: of the gearbox, for pitch and gap and the sleeves' travel.
    """

    def __init__(self, sheet: GearboxSheet, title: str) -> None:
        self._sheet = sheet
        self._title = title
        self._story = Story()
        self._lines: deque[Line] = deque(maxlen=LAST_LINES)
        self._shifts: deque[tuple[ShiftOutcome, str]] = deque(maxlen=LAST_SHIFTS)
        """How the last shifts ended, and where the tooth met if a rig has reported it."""
        self._contact = ""

    @property
    def heard(self) -> Heard:
        """What was heard last."""
        return self._story.heard

    def receive(self, time_s: float, frame: Frame) -> None:
        """One frame, heard at `time_s`."""
        reported = self._story.receive(time_s, frame)
        self._lines.extend(line for line in reported if line.who in REPORTED)
        self._remember(self._story.message)

    def lines(self) -> list[Text]:
        """`HEIGHT` lines of at most `WIDTH` characters."""
        drawn = [
            self._headline(),
            self._gear(),
            self._speeds(),
            Text(),
            *self._phase(),
            Text(),
            self._valves(),
            *self._sleeves(),
            self._pressures(),
            *self._bus(),
            self._last_shifts(),
            *self._reported(),
        ]
        drawn += [Text()] * (HEIGHT - len(drawn))
        for line in drawn:
            line.truncate(WIDTH)
        return drawn[:HEIGHT]

    def _remember(self, message: Message | None) -> None:
        if isinstance(message, ReferenceEngagement) and not self._contact:
            self._contact = CONTACT_KINDS.get(message.event, "")
        elif isinstance(message, TC1):
            self._contact = ""
        elif isinstance(message, ShiftOutcome):
            self._shifts.append((message, self._contact))
            self._contact = ""

    def _headline(self) -> Text:
        heard = self.heard
        text = Text(f"meshpoint watch {self._title}", style="bold")
        text.append(f"   {heard.bus_us / 1e6:.2f} s of bus, {heard.frames:,} frames", style="dim")
        if heard.foreign:
            text.append(f", {heard.foreign:,} foreign", style="yellow")
        return text

    def _gear(self) -> Text:
        status = self.heard.last(ControllerStatus)
        text = Text("gear   ")
        if status is None:
            return text.append("no controller heard", style="yellow")
        gear = status.current_gear
        text.append("N" if gear == 0 else str(gear) if gear > 0 else "?", style="bold reverse")
        if status.target_gear not in (gear, -1):
            text.append(f" -> {status.target_gear}", style="bold")
        text.append(f"  {state_words(status.state)}  ")
        text.append(f"{status.strategy.name.lower()}  ", style="dim")
        if status.active_fault is not FaultCode.NONE:
            text.append(status.active_fault.name.lower(), style="bold red")
        if status.guard_blocks:
            text.append(f"  guard blocks {status.guard_blocks}", style="yellow")
        return text

    def _speeds(self) -> Text:
        estimates, input_ = self.heard.last(ControllerEstimates), self.heard.last(ETC1)
        engine = self.heard.last(EEC1)
        words = [
            ("engine", None if engine is None else engine.engine_speed_rad_s),
            ("input", None if input_ is None else input_.input_shaft_speed_rad_s),
            ("layshaft", _if(estimates, "layshaft_valid", "layshaft_speed_rad_s")),
            ("main", _if(estimates, "main_valid", "main_speed_rad_s")),
        ]
        text = Text("rpm    ")
        for name, speed in words:
            text.append(f"{name} ", style="dim")
            text.append(f"{'-' if speed is None else f'{speed / RPM:.0f}':>5}  ")
        text.append("slip ", style="dim")
        slip = _if(estimates, "phase_known", "slip_rad_s")
        return text.append("    -" if slip is None else f"{slip / RPM:+7.1f}", style="bold")

    def _phase(self) -> list[Text]:
        """The gap with the gear's tooth in it or beside it, and where it shall meet."""
        pitch, gap = self._sheet.dog.pitch_rad, self._sheet.dog.backlash_rad
        estimates = self.heard.last(ControllerEstimates)
        known = estimates is not None and estimates.phase_known
        cells = [" "] * PHASE_CELLS
        half = gap / pitch / 2
        sleeve = Text("sleeve ")
        for k in range(PHASE_CELLS):
            inside = abs(k - PHASE_CELLS // 2) / PHASE_CELLS < half
            sleeve.append(" " if inside else "█", style="" if inside else "blue")
        words = "not known"
        if known and estimates is not None:
            phase = estimates.phase_rad
            cells[_cell(phase, pitch)] = "▲"
            words = f"{wrap_to_pitch(phase, pitch) / DEG:+.2f} deg"
        plan, aim = self.heard.last(ShiftPrediction), Text("aim    ")
        if plan is not None and self._is_shifting() and plan.phase_sd_rad > 0.0:
            marks = [" "] * PHASE_CELLS
            spread = plan.phase_sd_rad / pitch * PHASE_CELLS
            middle = _cell(plan.phase_rad, pitch)
            for k in range(PHASE_CELLS):
                if abs(k - middle) <= spread:
                    marks[k] = "─"
            marks[middle] = "┼"
            aim.append("".join(marks), style="green")
            aim.append(f" {wrap_to_pitch(plan.phase_rad, pitch) / DEG:+.2f} deg", style="green")
        tooth = Text("tooth  ")
        tooth.append("".join(cells), style="bold yellow")
        tooth.append(f" {words}", style="" if known else "dim")
        return [sleeve, tooth, aim]

    def _is_shifting(self) -> bool:
        status = self.heard.last(ControllerStatus)
        return status is not None and status.target_gear not in (status.current_gear, -1)

    def _valves(self) -> Text:
        status = self.heard.last(ValveStatus)
        text = Text("valves ")
        for valve in ValveName:
            name = valve.name.lower()
            on = status is not None and bool(getattr(status, f"{name}_energised"))
            waits = status is not None and bool(getattr(status, f"{name}_pending"))
            style = "bold reverse" if on else "yellow" if waits else "dim"
            text.append(_short_valve(name), style=style)
            text.append("*" if waits else " ")
        return text

    def _sleeves(self) -> list[Text]:
        main, aux = self.heard.last(SleevesMain), self.heard.last(SleevesAux)
        bars = (
            ("1 ", main and main.sleeve_first_second_m, " 2"),
            ("C ", main and main.sleeve_crawl_third_m, " 3"),
            ("lo", aux and aux.sleeve_splitter_m, "hi split"),
            ("lo", aux and aux.sleeve_range_m, "hi range"),
        )
        text = Text("sleeve ")
        for low, samples, high in bars:
            text.append(f"{low}", style="dim")
            text.append(_bar(samples[0] if samples else None, self._sheet.sleeve.stroke_m))
            text.append(f"{high}  ", style="dim")
        return [text]

    def _pressures(self) -> Text:
        sensors = self.heard.last(GearboxSensors)
        text = Text("air    ")
        if sensors is None:
            return text.append("no sensor side heard", style="yellow")
        brake, supply = sensors.brake_pressure_pa / BAR, sensors.supply_pressure_pa / BAR
        text.append(f"brake {brake:4.1f} bar(a)  supply {supply:4.1f} bar(a)  ")
        text.append(f"oil {sensors.oil_temperature_k - 273.15:3.0f} degC  ")
        return text.append(f"clutch {100 * sensors.clutch_position_fraction:3.0f} % closed")

    def _bus(self) -> list[Text]:
        """Every cyclic message: its rate, its age, whether it may be relied on."""
        cells = [self._message(name) for name in CYCLIC]
        rows = math.ceil(len(cells) / BUS_COLUMNS)
        lines = []
        for row in range(rows):
            line = Text()
            for cell in cells[row::rows]:
                line.append_text(cell)
            lines.append(line)
        return lines

    def _message(self, name: str) -> Text:
        heard = self.heard.messages[CODECS[name].spec.can_id]
        short = name
        for word, shorter in SHORT:
            short = short.replace(word, shorter)
        text = Text(f"{short:<14.14}", style="dim")
        if heard.newest is None:
            text.append(" -         ", style="dim")
        else:
            valid = self.heard.valid(CYCLIC[name])
            age_ms = 1000 * (self.heard.age_s(CYCLIC[name]) or 0.0)
            rate = f"{heard.rate_hz:4.0f}" if heard.rate_hz else "   -"
            text.append(f"{rate}/s {min(age_ms, 9999):4.0f}", style="" if valid else "bold red")
        text.append(" ")
        return text

    def _last_shifts(self) -> Text:
        text = Text("shifts ")
        for outcome, contact in self._shifts:
            took_ms = span_us(outcome.end_time_us, outcome.request_time_us) / 1000
            good = outcome.result is ShiftResult.ENGAGED
            text.append(f"{outcome.from_gear}-{outcome.to_gear} ", style="dim")
            verdict = f"{took_ms:.0f} ms {contact}" if good else outcome.result.name.lower()
            text.append(f"{verdict.strip()}   ", style="green" if good else "bold red")
        return text

    def _reported(self) -> Iterable[Text]:
        for line in self._lines:
            ms = "" if line.of_request_ms is None else f"{line.of_request_ms:+.0f} ms"
            yield Text(f"{ms:>8} {line.who:<10} {line.words}")


def _if(estimates: ControllerEstimates | None, valid: str, field: str) -> float | None:
    if estimates is None or not getattr(estimates, valid):
        return None
    return float(getattr(estimates, field))


def _cell(phase_rad: float, pitch_rad: float) -> int:
    """The character a phase lies in: 0 is half a pitch behind the middle of the gap."""
    share = wrap_to_pitch(phase_rad, pitch_rad) / pitch_rad + 0.5
    return min(int(share * PHASE_CELLS), PHASE_CELLS - 1)


def _bar(position_m: float | None, stroke_m: float) -> str:
    if position_m is None:
        return "?" * TRAVEL_CELLS
    middle = TRAVEL_CELLS // 2
    cell = middle + round(position_m / stroke_m * middle)
    cells = ["·"] * TRAVEL_CELLS
    cells[min(max(cell, 0), TRAVEL_CELLS - 1)] = "█"
    return "".join(cells)


def _short_valve(name: str) -> str:
    return name.replace("main_", "").replace("_", " ")
