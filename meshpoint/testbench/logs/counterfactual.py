"""What another strategy would have commanded on a recorded bus, beside what was commanded.

The log's sensors answer to the recorded commands alone: when a sleeve would have been fired, and
the phase then expected, follow from the log; where the tooth would have met does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.table import Table

from meshpoint.dbc.messages import PhaseReference, ShiftOutcome, ShiftResult
from meshpoint.testbench.results.output import broken
from meshpoint.testbench.results.road_speed import span_us
from meshpoint.testbench.results.rows import DEG


@dataclass(frozen=True)
class Command:
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
    other: Command
    recorded: Command | None

    def to_json(self) -> dict[str, Any]:
        """By name, as `replay --strategy --json` writes it."""
        recorded = None if self.recorded is None else _rounded(self.recorded)
        return {"from": self.from_, "to": self.to} | _rounded(self.other) | {"recorded": recorded}


class Counterfactuals:
    """Pairs outcomes of the replayed controller with those of the log, by the time of request."""

    def __init__(self) -> None:
        self._made: list[ShiftOutcome] = []
        self._recorded: dict[int, ShiftOutcome] = {}

    def made(self, outcome: ShiftOutcome) -> None:
        """An outcome of the replayed controller."""
        if outcome.result is not ShiftResult.REFUSED:
            self._made.append(outcome)

    def recorded(self, outcome: ShiftOutcome) -> None:
        """An outcome in the log."""
        self._recorded[outcome.request_time_us] = outcome

    def pairs(self) -> list[Counterfactual]:
        """In the order of the replay."""
        pairs = []
        for outcome in self._made:
            was = self._recorded.get(outcome.request_time_us)
            recorded = None if was is None else _command(was)
            pairs.append(
                Counterfactual(outcome.from_gear, outcome.to_gear, _command(outcome), recorded)
            )
        return pairs


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
        sides = [text for command in (pair.other, pair.recorded) for text in _cells(command)]
        table.add_row(str(pair.from_), str(pair.to), *sides)
    return table


def _command(outcome: ShiftOutcome) -> Command:
    known = outcome.reference is PhaseReference.KNOWN and outcome.attempts > 0
    fired_us = span_us(outcome.fire_time_us, outcome.request_time_us)
    return Command(
        strategy=outcome.strategy.name.lower(),
        reference=outcome.reference.name.lower(),
        fired_ms=fired_us / 1000 if outcome.attempts else None,
        predicted_phase_deg=outcome.predicted_phase_rad / DEG if known else None,
    )


def _cells(command: Command | None) -> list[str]:
    if command is None:
        return ["-", "-", "-"]
    fired, phase = command.fired_ms, command.predicted_phase_deg
    return [
        broken(command.strategy),
        "-" if fired is None else f"{fired:.1f}",
        "-" if phase is None else f"{phase:+.2f}",
    ]


def _rounded(command: Command) -> dict[str, Any]:
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in vars(command).items()}
