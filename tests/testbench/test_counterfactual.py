"""`replay --strategy`: two strategies on the same frames, shift beside shift."""

from __future__ import annotations

from rich.console import Console

from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import PhaseReference, ShiftOutcome, ShiftResult, Strategy
from meshpoint.testbench.logs.counterfactual import Counterfactuals, counterfactual_table
from meshpoint.units import DEG

REQUEST_US = (1 << 32) - 200_000
"""The sleeve is fired after the clock's wrap."""


SETTINGS = ControllerSettings()


def outcome(
    strategy: Strategy, fired_ms: float, request_us: int = REQUEST_US, attempts: int = 1
) -> ShiftOutcome:
    return ShiftOutcome(
        from_gear=8,
        to_gear=10,
        strategy=strategy,
        reference=PhaseReference.KNOWN,
        result=ShiftResult.ENGAGED if attempts else ShiftResult.ENDED_IN_NEUTRAL,
        attempts=attempts,
        request_time_us=request_us,
        fire_time_us=(request_us + round(fired_ms * 1000)) % (1 << 32),
        predicted_phase_rad=1.5 * DEG,
    )


def test_a_firing_stands_beside_the_recorded_one_of_the_same_request() -> None:
    both = Counterfactuals()
    for request_us, fired_ms in ((REQUEST_US, 380.0), (900_000, 390.0)):
        both.recorded(outcome(Strategy.TARGET_PHASE, fired_ms, request_us), SETTINGS)
    for request_us, fired_ms in ((900_000, 420.0), (REQUEST_US, 410.0)):
        both.made(outcome(Strategy.SPEED_WINDOW, fired_ms, request_us), SETTINGS)
    pairs = [pair.to_json() for pair in both.pairs()]
    assert [(pair["fired_ms"], pair["recorded"]["fired_ms"]) for pair in pairs] == [
        (420.0, 390.0),
        (410.0, 380.0),
    ]
    assert (pairs[0]["strategy"], pairs[0]["recorded"]["strategy"]) == (
        "speed_window",
        "target_phase",
    )
    assert pairs[0]["predicted_phase_deg"] == 1.5


def test_what_was_never_fired_has_no_time_and_no_phase() -> None:
    both = Counterfactuals()
    both.made(outcome(Strategy.SPEED_WINDOW, 0.0, attempts=0), SETTINGS)
    (pair,) = both.pairs()
    assert pair.other.fired_ms is None
    assert pair.other.predicted_phase_deg is None
    assert pair.recorded is None


def test_the_table_fits_a_terminal_of_80_columns() -> None:
    both = Counterfactuals()
    both.recorded(outcome(Strategy.TARGET_PHASE, 1380.0), SETTINGS)
    both.made(outcome(Strategy.SPEED_WINDOW, 1410.0), SETTINGS)
    out = Console(width=80, record=True)
    out.print(counterfactual_table("log", both.pairs()))
    text = out.export_text()
    assert "…" not in text
    for said in ("speed_window", "target_phase", "1410.0", "1380.0", "+1.50"):
        assert said in text
