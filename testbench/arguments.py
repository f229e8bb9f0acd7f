"""Arguments that several commands share, and how they become settings."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from controller.settings import (
    ESTIMATOR_NAMES,
    STRATEGY_NAMES,
    ControllerSettings,
    load_settings,
)
from gearbox import GearboxSheet, load_sheet
from gearbox.gears import DRIVE_GEARS, main_box_only
from gearbox.sheet import SHEET_NAMES
from rig_sim.settings import Preset

MAX_SHIFTS = 100_000


def whole(low: int, high: int):  # type: ignore[no-untyped-def]
    """An argparse type: a whole number from `low` to `high`."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"{text!r}, allowed is a whole number from {low} to {high}"
            )
        return value

    return parse


def speed(text: str) -> float:
    """An argparse type: how many times as fast as the wall clock."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 1e-3 <= value <= 1e3:
        raise argparse.ArgumentTypeError(f"{text!r}, allowed is a number from 0.001 to 1000")
    return value


def pairs(text: str) -> tuple[tuple[int, int], ...]:
    """An argparse type: `8-10,10-12`, upshifts of the main box alone."""
    parsed = []
    for item in text.split(","):
        before, _, after = item.partition("-")
        try:
            from_, to = int(before), int(after)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{item!r}, allowed is FROM-TO, as 8-10") from None
        if from_ not in DRIVE_GEARS or to not in DRIVE_GEARS or not main_box_only(from_, to):
            raise argparse.ArgumentTypeError(
                f"{item!r} moves more than the main box, or nothing; as 8-10, 7-9, 10-12"
            )
        parsed.append((from_, to))
    return tuple(parsed)


def add_gearbox(parser: argparse.ArgumentParser) -> None:
    """--gearbox."""
    parser.add_argument(
        "--gearbox",
        default="thesis",
        metavar="NAME|FILE",
        help=f"data sheet: {', '.join(SHEET_NAMES)}, or a TOML file (default: thesis)",
    )


def add_controller(parser: argparse.ArgumentParser, strategy: bool = True) -> None:
    """--settings, --estimator and --strategy."""
    parser.add_argument("--settings", type=Path, metavar="FILE", help="controller settings, TOML")
    parser.add_argument(
        "--estimator",
        choices=tuple(ESTIMATOR_NAMES),
        help="layshaft estimator: the thesis's Kalman filter or the 10 ms window speed of today",
    )
    if strategy:
        parser.add_argument(
            "--strategy",
            choices=tuple(STRATEGY_NAMES),
            help="speed_window: fire when the slip is inside its window, as is done today; "
            "target_phase: fire so that tooth meets gap (default)",
        )


def add_rig(parser: argparse.ArgumentParser) -> None:
    """--preset and --seed."""
    parser.add_argument(
        "--preset",
        choices=tuple(preset.value for preset in Preset),
        default=Preset.THESIS.value,
        help="physics of the rig (default: thesis, its equations 4.1-4.17 to the letter)",
    )
    add_seed(parser)


def add_seed(parser: argparse.ArgumentParser) -> None:
    """--seed."""
    parser.add_argument(
        "--seed",
        type=whole(0, 2**63 - 1),
        default=1,
        metavar="N",
        help="draws all start angles and delays (default: 1)",
    )


def add_speed(parser: argparse.ArgumentParser) -> None:
    """--speed."""
    parser.add_argument(
        "--speed",
        type=speed,
        default=1.0,
        metavar="X",
        help="run X times as fast as the wall clock; give both nodes the same (default: 1)",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """--json."""
    parser.add_argument(
        "--json", metavar="FILE|-", help="write the results as JSON to a file, or - for stdout"
    )


def add_shifts(parser: argparse.ArgumentParser, default: int, least: int) -> None:
    """--shifts and --pairs."""
    parser.add_argument(
        "--shifts",
        type=whole(least, MAX_SHIFTS),
        default=default,
        metavar="N",
        help=f"number of upshifts (default: {default})",
    )
    parser.add_argument(
        "--pairs",
        type=pairs,
        default=((8, 10), (10, 12)),
        metavar="LIST",
        help="shifts to cycle through, main box alone (default: 8-10,10-12)",
    )


def sheet_of(namespace: argparse.Namespace) -> GearboxSheet:
    """The data sheet asked for."""
    return load_sheet(namespace.gearbox)


def settings_of(namespace: argparse.Namespace, strategy: str | None = None) -> ControllerSettings:
    """The controller settings asked for; `strategy` wins over the namespace's."""
    return load_settings(
        namespace.settings,
        strategy_name=strategy or getattr(namespace, "strategy", None),
        estimator_name=namespace.estimator,
    )
