"""What another strategy would have commanded on a recorded bus, beside what was commanded.

The log's sensors answer to the recorded commands alone: when a sleeve would have been fired, and
the phase then expected, follow from the log; where the tooth would have met does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.table import Table

from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import PhaseReference, ShiftOutcome, ShiftResult
from meshpoint.testbench.results.output import broken
from meshpoint.testbench.results.road_speed import span_us
from meshpoint.units import DEG


@dataclass(frozen=True)
class Firing:
    """The last firing of a shift."""

    strategy: str
    reference: str
    fired_ms: float | None
    """From the request to the valve's activation; None where no sleeve was fired."""
    predicted_phase_deg: float | None
    """At contact, expected when it was fired; None without a phase reference."""


@dataclass(frozen=True)
class Counterfactual:
    """One shift as the other strategy commands it; `recorded` is None where the log has none."""

    from_: int
    to: int
    other: Firing
    recorded: Firing | None

    def to_json(self) -> dict[str, Any]:
        """By name, as `replay --strategy --json` writes it."""
        recorded = None if self.recorded is None else _rounded(self.recorded)
        return {"from": self.from_, "to": self.to} | _rounded(self.other) | {"recorded": recorded}


class Counterfactuals:
    """Pairs outcomes of the replayed controller with those of the log, by the time of request."""

    def __init__(self) -> None:
        self._made: list[tuple[ShiftOutcome, Firing]] = []
        self._recorded: dict[int, Firing] = {}

    def made(self, outcome: ShiftOutcome, settings: ControllerSettings) -> None:
        """An outcome of the replayed controller, and the settings that name its strategy."""
        if outcome.result is not ShiftResult.REFUSED:
            self._made.append((outcome, _firing(outcome, settings)))

    def recorded(self, outcome: ShiftOutcome, settings: ControllerSettings) -> None:
        """An outcome in the log, and the settings of the recorded controller."""
        self._recorded[outcome.request_time_us] = _firing(outcome, settings)

    def pairs(self) -> list[Counterfactual]:
        """In the order of the replay."""
        return [
            Counterfactual(
                outcome.from_gear,
                outcome.to_gear,
                firing,
                self._recorded.get(outcome.request_time_us),
            )
            for outcome, firing in self._made
        ]


def counterfactual_table(title: str, pairs: list[Counterfactual]) -> Table:
    """One row a shift; `log:` columns are what was recorded."""
    table = Table(
        title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True
    )
    for column in ("from", "to"):
        table.add_column(column, justify="right")
    for side in ("", "log:\n"):
        table.add_column(f"{side}strategy", no_wrap=True)
        table.add_column(f"{side}fired\nms", justify="right", no_wrap=True)
        table.add_column(f"{side}predicted\ndeg", justify="right", no_wrap=True)
    for pair in pairs:
        sides = [text for firing in (pair.other, pair.recorded) for text in _cells(firing)]
        table.add_row(str(pair.from_), str(pair.to), *sides)
    return table


def _firing(outcome: ShiftOutcome, settings: ControllerSettings) -> Firing:
    known = outcome.reference is PhaseReference.KNOWN and outcome.attempts > 0
    fired_us = span_us(outcome.fire_time_us, outcome.request_time_us)
    return Firing(
        strategy=settings.name_of(outcome.strategy),
        reference=outcome.reference.name.lower(),
        fired_ms=fired_us / 1000 if outcome.attempts else None,
        predicted_phase_deg=outcome.predicted_phase_rad / DEG if known else None,
    )


def _cells(firing: Firing | None) -> list[str]:
    if firing is None:
        return ["-", "-", "-"]
    fired, phase = firing.fired_ms, firing.predicted_phase_deg
    return [
        broken(firing.strategy),
        "-" if fired is None else f"{fired:.1f}",
        "-" if phase is None else f"{phase:+.2f}",
    ]


def _rounded(firing: Firing) -> dict[str, Any]:
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in vars(firing).items()}
