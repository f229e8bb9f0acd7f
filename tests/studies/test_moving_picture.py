"""The moving picture of a shift shows what was sampled, when it was sampled."""

from __future__ import annotations

import re
from typing import cast
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from benchmarks.abort_picture import Seen
from benchmarks.moving_picture import HOLD_S, SLOWER, picture
from meshpoint.gearbox import load_sheet
from meshpoint.results.rows import ShiftRow
from meshpoint.units import DEG, MM

SHEET = load_sheet("truck12")
SVG = "{http://www.w3.org/2000/svg}"


def seen() -> Seen:
    """A sleeve that is at 1 mm from 30 ms on and in its gear from 90 on; the gap comes by at 80."""
    ms = np.arange(-10.0, 110.0, 0.2)
    samples = {
        "position_m": np.interp(ms, [20.0, 30.0, 70.0, 80.0, 90.0], [0, 1, 1, 5, 12]) * MM,
        "phase_rad": (ms - 80.0) * 0.06 * DEG,
        "towards_coil": ((ms >= 0.0) & (ms < 20.0)) | (ms >= 50.0),
        "against_coil": (ms >= 20.0) & (ms < 30.0),
    }
    row = cast("ShiftRow", type("Row", (), {"from_": 8, "to": 10}))
    return Seen(row, SHEET, samples, ms, 0.0, 20.0, 30.0, 50.0, 45.0, 80.0)


@pytest.fixture(scope="module")
def drawn() -> ET.Element:
    return ET.fromstring(picture(seen()))


def numbers(animation: ET.Element, name: str) -> list[str]:
    return animation.attrib[name].split(";")


def test_every_animation_has_its_values_in_time_and_runs_as_long_as_the_others(
    drawn: ET.Element,
) -> None:
    animations = [*drawn.iter(f"{SVG}animate"), *drawn.iter(f"{SVG}animateTransform")]
    assert len(animations) >= 9
    lasts = {animation.attrib["dur"] for animation in animations}
    assert lasts == {f"{0.119 * SLOWER + HOLD_S:.1f}s"}
    for animation in animations:
        times = [float(time) for time in numbers(animation, "keyTimes")]
        assert len(times) == len(numbers(animation, "values"))
        assert times == sorted(times)
        assert (times[0], times[-1]) == (0.0, 1.0)


def test_at_each_moment_one_line_says_what_happens(drawn: ET.Element) -> None:
    lines = [text for text in drawn.iter(f"{SVG}text") if text.find(f"{SVG}animate") is not None]
    shown: dict[float, list[str]] = {}
    for share in np.linspace(0.001, 0.999, 200).tolist():
        for text in lines:
            animation = text.find(f"{SVG}animate")
            assert animation is not None
            times = [float(time) for time in numbers(animation, "keyTimes")]
            k = max(k for k, time in enumerate(times) if time <= share)
            if numbers(animation, "values")[k] == "1":
                shown.setdefault(share, []).append(str(text.text))
    assert len(shown) == 200
    assert {len(words) for words in shown.values()} == {1}
    order = list(dict.fromkeys(words[0].split(":")[0] for words in shown.values()))
    assert [words.split(" ")[0] for words in order] == [
        "the", "fired", "newer", "held", "fired", "tooth",
    ]  # fmt: skip


def test_the_sleeve_moves_as_it_was_sampled(drawn: ET.Element) -> None:
    """From rest, and to its gear: as many times as far as to the place where it was stopped."""
    ways = [
        [float(re.split(r"\s", value)[1]) for value in numbers(animation, "values")]
        for animation in drawn.iter(f"{SVG}animateTransform")
    ]
    (sleeve,) = (way for way in ways if max(way) > 0.0)
    assert sleeve[0] == 0.0
    assert sleeve[-1] / sleeve[50] == pytest.approx(12.0, rel=0.01)


def test_where_nothing_moves_the_contact_is_shown(drawn: ET.Element) -> None:
    shown = [t for t in drawn.iter(f"{SVG}text") if t.attrib.get("opacity") == "1"]
    assert [t.text for t in shown] == ["tooth meets gap: in gear"]
