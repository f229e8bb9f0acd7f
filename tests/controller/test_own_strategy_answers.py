"""A user's own strategy: what of its answers is taken, and which line of its file is named."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.controller.plan.own_strategy import OwnStrategy
from meshpoint.controller.plan.strategy import ReleasePlan
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.strategy_file import StrategyError, StrategyFile
from meshpoint.gearbox import load_sheet

SHEET, SETTINGS = load_sheet("thesis"), ControllerSettings()
HALF_GAP, PITCH = SHEET.dog.backlash_rad / 2.0, SHEET.dog.pitch_rad
PATH = "box/own.py"
NOW_US, EARLIEST_US, DELAY_US = 1_000, 20_000, 45_000
SECOND_US = 1_000_000


def text(
    release: str = "0, 0", contact: str = "None", slip: str = "2.5", aims: str = "True"
) -> bytes:
    """Line 4 makes it, 6 is asked for a release, 8 for a contact."""
    return f"""import math
class Own:
    aims, fire_slip_rad_s = {aims}, {slip}
    def __init__(self, sheet, settings):
        pass
    def release(self, predictor, now_us, earliest_us):
        return {release}
    def contact(self, predictor, now_us, earliest_us):
        return {contact}
""".encode()


def own(source: bytes, aims: bool = True) -> OwnStrategy:
    return OwnStrategy(StrategyFile(f"{PATH}:Own", "", aims, source), SHEET, SETTINGS)


def predictor(phase_of: Callable[[int], float] = lambda _: 0.0) -> Any:
    return SimpleNamespace(
        delay_us=DELAY_US, phase_and_slip=lambda time_us: (phase_of(time_us), 99.0)
    )


def released(release: object) -> ReleasePlan:
    return own(text(release=str(release))).release(predictor(), NOW_US, EARLIEST_US)


def met(contact: object) -> int | None:
    return own(text(contact=str(contact))).contact(predictor(), NOW_US, EARLIEST_US)


def refused(ask: Callable[[], object]) -> str:
    with pytest.raises(StrategyError) as error:
        ask()
    return str(error.value)


@pytest.mark.parametrize("aims", [True, False])
def test_it_aims_as_its_file_says_and_fires_at_its_own_slip(aims: bool) -> None:
    made = own(text(slip="-7.25"), aims)
    assert made.aims is aims
    assert made.fire_slip_rad_s == -7.25


@pytest.mark.parametrize("slip", [100.0, -100.0, 0])
def test_it_may_fire_at_a_hundred_rad_s_to_either_side(slip: float) -> None:
    assert own(text(slip=str(slip))).fire_slip_rad_s == slip


@pytest.mark.parametrize("slip", ["100.1", "-100.1", "math.nan", "'3'", "True", "None", "10**400"])
def test_no_other_slip_to_fire_at_is_taken(slip: str) -> None:
    said = refused(lambda: own(text(slip=slip)))
    assert said.startswith(f"{PATH}:4: fire_slip_rad_s is ")
    assert said.endswith("allowed is a number from -100 to 100")


def test_a_release_within_a_second_and_a_contact_within_two_are_taken() -> None:
    first, last = EARLIEST_US, EARLIEST_US + SECOND_US
    assert released((first, first)) == (first, first)
    assert released((last, last + SECOND_US)) == (last, last + SECOND_US)
    assert released((first + 0.6, last + 0.4)) == (first + 1, last)
    assert released((first + 7, first + 3)) == (first + 7, first + 3)


@pytest.mark.parametrize(
    ("release", "what"),
    [((EARLIEST_US - 1, EARLIEST_US), "release_us"),
     ((EARLIEST_US + SECOND_US + 1, EARLIEST_US), "release_us"),
     ((EARLIEST_US, EARLIEST_US - 1), "contact_us"),
     ((EARLIEST_US, EARLIEST_US + 2 * SECOND_US + 1), "contact_us")],
)  # fmt: skip
def test_a_release_that_is_too_soon_or_too_late_is_named(
    release: tuple[int, int], what: str
) -> None:
    last_us = EARLIEST_US + (1 if what == "release_us" else 2) * SECOND_US
    wrong = release[0] if what == "release_us" else release[1]
    said = refused(lambda: released(release))
    assert said == (
        f"{PATH}:6: release() {what} is {wrong}, allowed is a time from {EARLIEST_US} to "
        f"{last_us} us"
    )


@pytest.mark.parametrize("answer", ["7", "(1,)", "(1, 2, 3)", "[1, 2]", "None", "{1: 2, 3: 4}"])
def test_a_release_is_two_times(answer: str) -> None:
    said = refused(lambda: released(answer))
    assert said == (
        f"{PATH}:6: release() returned {answer}, allowed are two times: (release_us, contact_us)"
    )


def test_a_contact_is_when_the_sleeve_can_be_there_or_up_to_a_second_later() -> None:
    first = EARLIEST_US + DELAY_US
    assert met(None) is None
    for contact in (first, first + SECOND_US):
        assert met(contact) == contact
    assert met(first + 10.7) == first + 11
    for contact in (first - 1, first + SECOND_US + 1):
        assert refused(lambda at=contact: met(at)) == (  # type: ignore[misc]
            f"{PATH}:8: contact() is {contact}, allowed is a time from {first} to "
            f"{first + SECOND_US} us"
        )


@pytest.mark.parametrize(
    ("on_way", "again", "goes_back"),
    [(0.0, 0.0, False), (HALF_GAP, 0.0, False), (-HALF_GAP, 0.0, False),
     (1.001 * HALF_GAP, HALF_GAP, True), (-1.001 * HALF_GAP, -HALF_GAP, True),
     (1.001 * HALF_GAP, -1.001 * HALF_GAP, False), (PITCH, 0.0, False),
     (PITCH / 2.0, -3.0 * PITCH, True), (PITCH / 2.0, 1.15 * HALF_GAP, False)],
)  # fmt: skip
def test_a_sleeve_goes_back_from_a_tooth_to_a_gap(
    on_way: float, again: float, goes_back: bool
) -> None:
    """A gap is half a backlash to either side, whichever of the teeth it is."""
    contact_us, again_us = 50_000, EARLIEST_US + DELAY_US + 5_000
    phases = {contact_us: on_way, again_us: again}
    made = own(text(contact=str(again_us)))
    at = predictor(phases.__getitem__)
    assert made.is_to_go_back(at, NOW_US, contact_us, EARLIEST_US) is goes_back


def test_a_sleeve_stays_where_no_other_contact_is_planned() -> None:
    at = predictor(lambda _: PITCH / 2.0)
    assert own(text()).is_to_go_back(at, NOW_US, 50_000, EARLIEST_US) is False


def test_what_it_raises_is_named_by_the_line_that_was_running() -> None:
    assert refused(lambda: released("1 / 0, 0")) == f"{PATH}:7: ZeroDivisionError: division by zero"
    said = refused(lambda: own(b"import math\n\nmath.sqrt(-1)\nclass Own: pass\n"))
    assert said.startswith(f"{PATH}:3: ValueError: ")
    assert refused(lambda: own(b"raise SystemExit(3)")) == f"{PATH}:1: SystemExit: 3"


def test_of_a_call_of_a_call_the_innermost_line_of_the_file_is_named() -> None:
    source = text("self.wrong(), 0") + b"    def wrong(self):\n        return int('x')\n"
    said = refused(lambda: own(source).release(predictor(), NOW_US, EARLIEST_US))
    assert said.startswith(f"{PATH}:11: ValueError: ")


def test_a_method_that_wants_other_arguments_is_named_by_its_own_line() -> None:
    source = text().replace(b"contact(self, predictor, now_us, earliest_us)", b"contact(self)")
    said = refused(lambda: own(source).contact(predictor(), NOW_US, EARLIEST_US))
    assert said.startswith(f"{PATH}:8: TypeError: ")
    said = refused(lambda: own(text().replace(b"__init__(self, sheet, settings)", b"__init__(s)")))
    assert said.startswith(f"{PATH}:4: TypeError: ")


def test_where_nothing_of_the_file_is_at_fault_its_first_line_is_named() -> None:
    """A class without a function of its own has no line; one from elsewhere has none here."""
    said = refused(lambda: own(b"\n\nclass Own: pass"))
    assert said.startswith(f"{PATH}:1: TypeError: ")
    said = refused(lambda: own(b"from fractions import Fraction as Own"))
    assert said.startswith(f"{PATH}:1: TypeError: ")
    assert refused(lambda: own(b"")) == f"{PATH}:1: there is no class Own in it"
    assert refused(lambda: own(b"Own = 3")) == f"{PATH}:1: there is no class Own in it"


def test_a_file_that_has_not_been_read_is_named() -> None:
    file = StrategyFile("own.py:Own", "", True, None)
    said = refused(lambda: OwnStrategy(file, SHEET, SETTINGS))
    assert said == "own.py:Own: its file has not been read"


SHOWN = """class Shown({2}):
    def __repr__(self): return {0}
    def __str__(self): return {1}
"""


def reported(repr_: str, str_: str = "''", raised: bool = False) -> str:
    """How an object that is shown so is reported: as an answer, or as it is raised."""
    shown = SHOWN.format(repr_, str_, "Exception" if raised else "").encode()
    body = b"    def wrong(self): raise Shown\n" if raised else b""
    source = text(contact="self.wrong()" if raised else "Shown()") + body + shown
    return refused(lambda: own(source).contact(predictor(), NOW_US, EARLIEST_US))


def test_whatever_it_returns_is_shown_in_one_line_of_two_hundred_signs() -> None:
    long = reported("'x' * 300 + '\\n'")
    assert long.startswith(f"{PATH}:8: contact() is {'x' * 200}, allowed")
    assert reported("'one\\ntwo'").startswith(f"{PATH}:8: contact() is one, allowed")
    assert reported("''").startswith(f"{PATH}:8: contact() is , allowed")
    assert reported("1 / 0").startswith(f"{PATH}:8: contact() is a Shown, allowed")


def test_what_it_raises_is_told_by_its_message() -> None:
    assert reported("'repr'", "'message'", raised=True) == f"{PATH}:10: Shown: message"


def test_nothing_that_is_no_number_is_a_time() -> None:
    for answer in ("'70000'", "True", "math.nan", "math.inf", "[]", "10**400"):
        assert "contact() is " in refused(lambda said=answer: met(said))  # type: ignore[misc]
