"""The law of the main sleeves by a log: sleeves of which it is known what they are."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from meshpoint.gearbox import Sleeve, load_sheet
from meshpoint.testbench.identify.identified import Identified
from meshpoint.testbench.identify.identify import identify
from meshpoint.testbench.identify.log_reader import LogContent

sys.path.append(str(Path(__file__).parent.parent / "controller"))

from drawn_sleeve import NARROW, DrawnSleeve
from sleeve_bench import SleeveBench

SHEET = load_sheet("truck12")
LAW = ("sleeve valve {} on delay", "sleeve valve {} off delay", "sleeve delay {}, actuator model",
       "sleeve delay {} per bar of supply", "sleeve detent {}",
       "sleeve stopping distance {}")  # fmt: skip


def told(content: LogContent, commands: int = 1) -> Identified:
    content.messages["ValveCommand"] = commands
    return identify(content, SHEET)


def test_the_law_that_was_learned_is_told_with_intervals() -> None:
    """Of a narrow valve, without a detent: the data sheet has one of 600 N. Its delay by itself."""
    sleeve = DrawnSleeve(NARROW, 3, 3e-4)
    bench = SleeveBench(SHEET, sleeve)
    delays_ms = []
    for _ in range(4):
        delays_ms.append(1e-3 * bench.fire()[1])
        bench.back()
    content = LogContent(sleeves=bench.sleeves, moved={Sleeve.FIRST_SECOND})
    found = told(content)
    truths = {
        "sleeve valve second on delay": 1e3 * sleeve.on_s[0],
        "sleeve delay second, actuator model": sum(delays_ms) / len(delays_ms),
        "sleeve detent second": 0.0,
    }
    for name, truth in truths.items():
        figure = found.figure(name)
        assert figure.low is not None
        assert figure.high is not None
        assert figure.low < truth < figure.high, name
        assert figure.samples > 4
    by_air = found.figure("sleeve delay second per bar of supply")
    assert by_air.high is not None
    assert by_air.high < 0.0, "more air, a shorter stroke"
    stops = found.figure("sleeve stopping distance second")
    assert stops.value is not None
    assert 0.5 < stops.value < 1e3 * SHEET.sleeve.to_contact_m
    unmoved = found.figure("sleeve delay third, actuator model")
    assert unmoved.why == "this sleeve did not move in the log"
    assert found.figure("sleeve delay by temperature").why


@pytest.mark.parametrize(
    ("commands", "inexact", "moved", "why"),
    [
        (0, 0, set(), "no valve commands in the log"),
        (9, 0, set(), "no main sleeve moved in the log"),
        (9, 0, {Sleeve.CRAWL_THIRD}, "this sleeve did not move in the log"),
        (9, 2, {Sleeve.FIRST_SECOND}, "its valves were switched at once, not at a commanded time"),
        (9, 0, {Sleeve.FIRST_SECOND}, "none of its movements went by the law"),
    ],
)
def test_a_log_that_tells_no_law_says_why(
    commands: int, inexact: int, moved: set[Sleeve], why: str
) -> None:
    found = told(LogContent(moved=moved, inexact=inexact), commands)
    for name in LAW:
        figure = found.figure(name.format("first"))
        assert (figure.value, figure.why) == (None, why)
        assert figure.sheet is not None
