"""The rows of the table: what is changed from an ordinary campaign, and why it is looked at.

A row is a campaign of the sheet `truck12`, or of one that is named. To add one, add it here;
nothing else has to change.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final

from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET: Final = load_sheet("truck12")


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    changed: str
    """What is changed, as the table says it."""
    why: str
    """What the row shows that others do not."""
    profile: str = "typical"
    as_built: str = ""
    """Values of the gearbox that are fixed, TOML below the profile."""
    sheet: str = ""
    """What the data sheet has otherwise, TOML over `truck12`; or the name of another one."""
    settings: str = ""
    """The controller's settings, TOML."""
    words: tuple[str, ...] = ()
    """Further arguments of `meshpoint campaign`."""
    gearboxes: int = 32
    learn: int = 6
    judged: int = 4
    seed: int = 917

    def quick(self) -> Row:
        """The same in a quarter of the time."""
        gearboxes, judged = min(self.gearboxes, QUICK_GEARBOXES), min(self.judged, QUICK_JUDGED)
        return replace(self, gearboxes=gearboxes, judged=judged)

    def drawn(self, times: int, seed: int) -> Row:
        """The same with this many times the gearboxes, `seed` added to its own."""
        return replace(self, gearboxes=times * self.gearboxes, seed=self.seed + seed)


QUICK_GEARBOXES: Final = 10
QUICK_JUDGED: Final = 3


@dataclass(frozen=True)
class Group:
    """Rows of one kind, below a heading."""

    title: str
    about: str
    rows: tuple[Row, ...] = field(default_factory=tuple)


def one_change(
    name: str,
    changed: str,
    why: str,
    as_built: str = "",
    sheet: str = "",
    words: tuple[str, ...] = (),
) -> Row:
    """A row of the profile `clean` with one thing changed, on the draws of all of them."""
    return Row(
        name, changed, why, "clean", as_built, sheet, words=words, learn=5, judged=3, seed=900
    )


BOXES: Final = ("main", "split", "range_")


def steps(pairs: Iterable[tuple[int, int]]) -> tuple[str, str]:
    """The argument for these gear changes."""
    return "--pairs", ",".join(f"{before}-{after}" for before, after in pairs)


def changes(what: Iterable[str], by: int) -> list[tuple[int, int]]:
    """Gear changes in which these differ and nothing else, the main gear by `by` where it does."""
    wanted = set(what)
    found = []
    for before, a in DRIVE_GEARS.items():
        for after, b in DRIVE_GEARS.items():
            if {key for key in BOXES if getattr(a, key) != getattr(b, key)} == wanted and (
                "main" not in wanted or b.main - a.main == by
            ):
                found.append((before, after))
    return found


BY_RATIO: Final = (13, 14, *range(1, 13))
"""All gears from the lowest."""
NEIGHBOURS: Final = tuple(itertools.pairwise(BY_RATIO))
DOWN: Final = (*changes({"main"}, -1)[2:], (1, 13), (2, 14))
BACK_OF_RANGE: Final = ((7, 5), (8, 6), (7, 6))
ACROSS_RANGE: Final = ((5, 7), (6, 8), (6, 7))
HALL: Final = "[hall]\njitter_us = {}\npitch_error_deg = 0.3\nrunout_mm = 0.2\n"


def lighter(factor: float) -> str:
    """The data sheet with layshaft and input shaft of this share of their inertia."""
    shafts = SHEET.shafts
    return (
        f"[shafts]\nlayshaft_inertia_kgm2 = {factor * shafts.layshaft_inertia_kgm2:g}\n"
        f"input_inertia_kgm2 = {factor * shafts.input_inertia_kgm2:g}\n"
    )


def dog(line: str) -> str:
    """The data sheet with other dog teeth."""
    return f"[dog]\n{line}\n"


def tick(ms: int) -> str:
    """Settings with another tick."""
    return f"[timing]\ntick_ms = {ms}\n"


PROFILES: Final = Group(
    "Profiles",
    "Ranges that a gearbox's parts are drawn from.",
    (
        one_change("clean", "nothing", "what the rows with one change are held against"),
        Row("typical", "nothing", "the headline, and what the rows below are held against",
            gearboxes=48, judged=8),
        Row("harsh", "profile `harsh`", "twice the deviations", "harsh", gearboxes=48),
    ),
)  # fmt: skip
DEVIATIONS: Final = Group(
    "One deviation",
    "Profile `clean` with one thing changed.",
    (
        one_change("valves", "brake valve +-1 ms", "chance in the brake's release",
                   "[air]\nvalve_scatter_ms = 1\n"),
        one_change("sleeve", "sleeve's delay +-2.5 ms", "chance in the sleeve's way",
                   "[sleeve]\nnoise_sd_ms = 2.5\nnoise_limit_ms = 5\n"),
        one_change("pressure", "brake's pressure sensor 0.3 bar off, noise 0.05 bar",
                   "a brake that acts as no sensor says",
                   "[pressure]\nbrake_offset_bar = 0.3\nnoise_bar = 0.05\n"),
        one_change("torque_1", "1 Nm of chance at the layshaft", "churning oil",
                   "[disturbance]\nlayshaft_nm = 1\n"),
        one_change("torque_3", "3 Nm of chance at the layshaft", "the same, as much as there is",
                   "[disturbance]\nlayshaft_nm = 3\n"),
        one_change("hall_20", "Hall edges 20 us, 0.3 deg, 0.2 mm", "worn wheels",
                   HALL.format(20)),
        one_change("hall_40", "Hall edges 40 us, 0.3 deg, 0.2 mm", "a reference hard to learn",
                   HALL.format(40)),
        one_change("soft_shafts", "shafts of 20,000 Nm/rad, 20 Nms, no backlash",
                   "a driveline that swings and hardly damps",
                   "[driveline]\nstiffness_nm_rad = 20000\ndamping_nms = 20\n"),
    ),
)  # fmt: skip
WORK: Final = Group(
    "Conditions of work",
    "Profile `typical`, drawn between 40 and 100 degC, 8 and 44 t, -4 and +4 %, -0.8 and +0.3 bar, "
    "but for what is fixed.",
    (
        Row("cold", "oil of -20 degC", "drag, and sleeves that are slow",
            as_built="[oil]\ntemperature_c = -20\n"),
        Row("low_supply", "supply 2 bar below the sheet's", "sleeves and brake that are slow",
            as_built="[air]\nsupply_offset_bar = -2\n"),
        Row("uphill", "road of +8 %", "a truck that gets slower in neutral",
            as_built="[vehicle]\nslope_percent = 8\n"),
        Row("downhill", "road of -8 %", "a truck that gets faster in neutral",
            as_built="[vehicle]\nslope_percent = -8\n"),
        Row("t_8", "8 t", "a driveline that swings fast", as_built="[vehicle]\nmass_kg = 8000\n"),
        Row("t_44", "44 t", "a driveline that swings slowly",
            as_built="[vehicle]\nmass_kg = 44000\n"),
    ),
)  # fmt: skip
SHEETS: Final = Group(
    "Data sheets",
    "Profile `clean`, another gearbox.",
    (
        one_change("thesis", "sheet `thesis`", "the gearbox of the thesis", sheet="thesis"),
        one_change("gap_8", "gap of 8 % of the pitch", "a small gap, a reference hard to learn",
                   sheet=dog("backlash_percent_of_pitch = 8")),
        one_change("gap_33", "gap of 33 % of the pitch", "a wide gap: flanks far apart",
                   sheet=dog("backlash_percent_of_pitch = 33")),
        one_change("dog_31", "31 dog teeth", "no common divisor with any gear",
                   sheet=dog("teeth = 31")),
        one_change("inertia_25", "inertias x 0.25", "shafts that drag stops within a sleeve's way",
                   sheet=lighter(0.25)),
        one_change("inertia_60", "inertias x 0.6", "the same, half way", sheet=lighter(0.6)),
    ),
)  # fmt: skip
KINDS: Final = Group(
    "Kinds of shift",
    "Profile `typical` unless said; upshifts by one main gear are the row `typical`. Changes of "
    "the splitter alone have no dog teeth to meet.",
    (
        Row("down", "downshifts by one main gear", "the engine raises the gear", words=steps(DOWN)),
        one_change("down_clean", "the same, profile `clean`", "without the driveline's swing",
                   words=steps(DOWN)),
        Row("splitter", "splitter alone", "time and failures",
            words=steps(changes({"split"}, 0))),
        Row("splitter_up", "splitter and main gear, up", "the layshaft is brought twice",
            words=steps(changes({"split", "main"}, 1))),
        Row("splitter_down", "splitter and main gear, down", "the same, raised",
            words=steps(changes({"split", "main"}, -1))),
        Row("range_up", "across the range, up", "both boxes move",
            words=steps(ACROSS_RANGE)),
        Row("range_down", "across the range, down", "both boxes move, raised",
            words=steps(BACK_OF_RANGE)),
        Row("skip_up", "two main gears at once, up", "braked for long",
            words=steps(changes({"main"}, 2))),
        Row("skip_down", "two main gears at once, down", "raised for long",
            words=steps(changes({"main"}, -2))),
        Row("all_gears", "each of the 14 gears to the next, up and down", "as in driving",
            words=steps([*NEIGHBOURS, *((b, a) for a, b in NEIGHBOURS)])),
    ),
)  # fmt: skip
SPLIT_UP: Final = tuple((a, b) for a, b in changes({"split"}, 0) if a < b)
ACROSS_UP: Final = changes({"split", "main"}, 1)
ACROSS_DOWN: Final = changes({"split", "main"}, -1)
DOG_SPLITTER: Final = Group(
    "A splitter with dog teeth",
    "Sheet `truck12-dog`, profile `typical`. The splitter's sleeve is fired by its speed, not "
    "aimed; in a change of both, first in gap is the main gear's and J that of both.",
    (
        Row("dog_split_up", "splitter alone, up", "the engine slows the input shaft down",
            sheet="truck12-dog", words=steps(SPLIT_UP)),
        Row("dog_split_down", "splitter alone, down", "the engine raises it",
            sheet="truck12-dog", words=steps((b, a) for a, b in SPLIT_UP)),
        Row("dog_across_up", "splitter and main gear, up", "one after the other",
            sheet="truck12-dog", words=steps(ACROSS_UP)),
        Row("dog_across_down", "splitter and main gear, down", "the same",
            sheet="truck12-dog", words=steps(ACROSS_DOWN)),
        Row("dog_all_gears", "each of the 14 gears to the next, up and down", "as in driving",
            sheet="truck12-dog", words=steps([*NEIGHBOURS, *((b, a) for a, b in NEIGHBOURS)])),
    ),
)  # fmt: skip
LEARNING: Final = Group(
    "Shifts to learn",
    "Profile `typical`; elsewhere six, five on `clean`.",
    tuple(
        Row(f"learned_{count}", f"{count} shifts to learn", why, learn=count)
        for count, why in ((0, "a gearbox nobody knows"), (2, "a reference at first"),
                           (5, "sleeves learned"))
    ),
)  # fmt: skip
RESTS: Final = Group(
    "Time since the last shift",
    "Profile `typical`: from the clutch's closing in the old gear to the request; elsewhere until "
    "the driveline has settled, 0.6 to 3 s.",
    tuple(
        Row(f"rest_{ms}", f"{ms:,} ms after the last shift", why, words=("--rest", str(ms)))
        for ms, why in ((0, "the driveline swings as after a lock"), (150, "the same, less"),
                        (300, "the loaded driveline is just known"), (1000, "as in driving"))
    ),
)  # fmt: skip
TICKS: Final = Group(
    "The controller's tick",
    "Profile `typical`; elsewhere 10 ms.",
    tuple(
        Row(f"tick_{ms}", f"a tick of {ms} ms", why, settings=tick(ms))
        for ms, why in ((5, "every other step has no new read"), (20, "a slower node"))
    ),
)
GROUPS: Final = (PROFILES, DEVIATIONS, WORK, SHEETS, KINDS, DOG_SPLITTER, LEARNING, RESTS, TICKS)
ROWS: Final = {row.name: row for group in GROUPS for row in group.rows}
"""By name, in the table's order."""
