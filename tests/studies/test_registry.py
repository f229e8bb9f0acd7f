"""The studies cover the thesis, and each can be named."""

from __future__ import annotations

import dataclasses

import pytest

from benchmarks.studies.registry import STUDY_NAMES, chosen, load
from benchmarks.studies.settings import load_study_settings
from meshpoint.base.errors import CommandError

FIGURES = {f"figure 6.{number}" for number in range(1, 14)}
TABLES = {"table 6.1", "table 6.2"}


def test_every_figure_and_table_of_the_results_has_one_study() -> None:
    held = [
        item for name in STUDY_NAMES for item in load(name).of if item.startswith(("fig", "tab"))
    ]
    assert sorted(held) == sorted(FIGURES | TABLES)


@pytest.mark.parametrize("name", STUDY_NAMES)
def test_every_setting_has_a_shipped_value(name: str) -> None:
    study = load(name)
    given = load_study_settings(None).given(study)
    assert {field.name for field in dataclasses.fields(given.own)}


def test_a_study_is_found_by_name_or_by_what_it_reproduces_and_runs_once() -> None:
    assert [study.name for study in chosen(["6.12", "table 6.1", "valve"])] == [
        "valve",
        "speed_estimate",
    ]
    assert [study.name for study in chosen(["all"])] == list(STUDY_NAMES)


@pytest.mark.parametrize(
    ("word", "names"),
    [
        ("6.1", ["valve"]),
        ("figure 6.1", ["valve"]),
        ("table 6.1", ["speed_estimate"]),
        ("6.2", ["torque"]),
        ("1.3", ["hardware", "target"]),
    ],
)
def test_a_number_alone_is_that_of_a_figure_where_there_is_one(word: str, names: list[str]) -> None:
    assert [study.name for study in chosen([word])] == names


def test_an_unknown_study_is_named_with_those_that_are_allowed() -> None:
    with pytest.raises(CommandError, match=r"(?s)'6\.99'.*valve, torque") as refused:
        chosen(["6.99"])
    assert max(map(len, f"python -m benchmarks.studies: error: {refused.value}".splitlines())) <= 80
