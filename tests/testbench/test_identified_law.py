"""The law of the main sleeves by a log: sleeves of which it is known what they are."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from meshpoint.gearbox import Sleeve, load_sheet
from meshpoint.identify.identified import Identified
from meshpoint.identify.identify import identify
from meshpoint.identify.log_reader import LogContent

sys.path.append(str(Path(__file__).parent.parent / "controller"))

from drawn_sleeve import NARROW, DrawnSleeve
from sleeve_bench import SleeveBench

SHEET = load_sheet("truck12")
LAW = ("sleeve valve {} on delay", "sleeve valve {} off delay")
NEVER = ("sleeve delay by temperature", "sleeve delay per bar of supply", "sleeve detent")


def told(content: LogContent, commands: int = 1) -> Identified:
    content.messages["ValveCommand"] = commands
    return identify(content, SHEET)


def taught(*seeds: int) -> list[tuple[DrawnSleeve, Identified]]:
    """Sleeves of narrow valves, without a detent: the data sheet has one of 600 N."""
    found = []
    for seed in seeds:
        sleeve = DrawnSleeve(NARROW, seed, 3e-4)
        bench = SleeveBench(SHEET, sleeve)
        for _ in range(4):
            bench.fire()
            bench.back()
        content = LogContent(sleeves=bench.sleeves, moved={Sleeve.FIRST_SECOND})
        found.append((sleeve, told(content)))
    return found


def test_a_valve_s_delays_are_told_with_intervals_that_hold_them() -> None:
    """An interval is never narrower than what the law leaves out makes it."""
    for sleeve, found in taught(3, 4, 5):
        for name, truth_s, least_ms in (
            ("sleeve valve second on delay", sleeve.on_s[0], 2.0),
            ("sleeve valve second off delay", sleeve.off_s[0], 1.2),
        ):
            figure = found.figure(name)
            if figure.low is None or figure.high is None:
                assert figure.why == "no movement in the log shows it"
                continue
            assert figure.low < 1e3 * truth_s < figure.high, name
            assert figure.high - figure.low > 2.0 * least_ms
            assert figure.samples > 4


def test_a_sleeve_that_did_not_move_tells_nothing() -> None:
    ((_, found),) = taught(3)
    unmoved = found.figure("sleeve valve third on delay")
    assert (unmoved.value, unmoved.why) == (None, "this sleeve did not move in the log")


def test_what_movements_cannot_tell_apart_is_given_no_number_and_is_named_once() -> None:
    ((_, found),) = taught(3)
    names = [one.name for one in found.figures]
    assert len(names) == len(set(names))
    for name in NEVER:
        figure = found.figure(name)
        assert (figure.value, figure.low, figure.high) == (None, None, None)
        assert figure.why
    assert [name for name in names if "detent" in name or "per bar" in name] == list(NEVER[1:])


def test_of_a_splitter_with_dog_teeth_valves_are_told_and_its_teeth_are_given_no_number() -> None:
    dog = load_sheet("truck12-dog")
    names = {one.name: one for one in identify(LogContent(), dog).figures}
    for step in ("low_split", "high_split"):
        assert {f"sleeve delay {step}", *(name.format(step) for name in LAW)} <= set(names)
    for name in ("splitter tooth offset", "splitter backlash"):
        assert names[name].value is None
        assert names[name].why
    assert not any("split" in one.name for one in identify(LogContent(), SHEET).figures)


def test_a_gear_s_delay_is_printed_once() -> None:
    ((_, found),) = taught(3)
    assert [one.name for one in found.figures if one.name.startswith("sleeve delay second")] == [
        "sleeve delay second"
    ]


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
