"""How the command line reads and explains itself: help that teaches, errors of one line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, Final, NoReturn

from meshpoint.base.columns import folded
from meshpoint.base.exits import Exit

MOST_IN_USAGE = 4
"""A usage line with more options than this says `[options]`: each is explained below it anyway."""

EXAMPLES: Final[dict[str, tuple[str, ...]]] = {
    "demo": ("meshpoint demo --shifts 4", "meshpoint demo --seed 7 --pairs mixed --out out/mixed"),
    "simulate": (
        "meshpoint simulate --shifts 20 --seed 1",
        "meshpoint simulate --pairs mixed --log run.log --report run.html",
    ),
    "campaign": (
        "meshpoint campaign --runs 300 --true-state --json campaign.json",
        "meshpoint campaign --runs 20 --seed 9 --sweep backlash_percent=10,20,30",
    ),
    "compare": (
        "meshpoint compare before.json after.json --tolerance duration_ms=5",
        "meshpoint compare a.log b.log --ignore 'Reference*' --report difference.html",
        "meshpoint compare a.toml b.toml --log out/demo/speed_window.log",
    ),
    "replay": (
        "meshpoint replay out/demo/target_phase.log --verify",
        "meshpoint replay out/demo/target_phase.log --strategy speed_window",
        "meshpoint replay out/demo/speed_window.log --gap-rate",
    ),
    "identify": (
        "meshpoint identify out/demo/target_phase.log --gearbox truck12",
        "meshpoint identify bench.blf --gearbox own.toml -o identified.toml --json -",
    ),
    "tell": (
        "meshpoint tell out/demo/target_phase.log",
        "meshpoint tell run.log --only driver truth --json",
    ),
    "watch": (
        "meshpoint watch",
        "meshpoint watch -i socketcan -c can0",
        "meshpoint watch out/demo/target_phase.log --speed 0.2",
    ),
    "up": (
        "meshpoint up",
        "meshpoint up --seed 7 --strategy speed_window --log run.log",
        "meshpoint up --truck --log truck.log",
        "meshpoint up --pace-only bus.time",
    ),
    "controller": (
        "meshpoint controller --header-dir .",
        "meshpoint controller -i socketcan -c can0 --settings bench.toml --arm",
        "meshpoint controller -i socketcan -c can0 --shadow --log bench/",
    ),
    "rig": ("meshpoint rig --seed 7 --gear 8", "meshpoint rig --describe"),
    "request": ("meshpoint request 10",),
    "check": (
        "meshpoint check -i socketcan -c can0 --gearbox box.toml",
        "meshpoint check --turn main propeller --json check.json",
        "meshpoint check --alive controller -i socketcan -c vcan0",
    ),
    "commission": (
        "meshpoint commission -i socketcan -c can0 --out measured.toml",
        "meshpoint commission --turn --out measured.toml --calibration box.toml",
        "meshpoint commission --drawn 20 --gearbox truck12",
    ),
    "play": ("meshpoint play", "meshpoint play --gearbox thesis --out slow.html"),
    "firmware": ("meshpoint firmware", "meshpoint firmware --by gcc -o build/firmware"),
    "a2l": ("meshpoint a2l", "meshpoint a2l -o truck.a2l"),
    "fmu": ("meshpoint fmu", "meshpoint fmu -o gearbox.fmu"),
    "convert": (
        "meshpoint convert x.log -o x.mcap",
        "meshpoint convert logs/ -o x.mf4 --gearbox box.toml",
        "meshpoint convert --live -i socketcan -c can0",
    ),
    "captures": (
        "meshpoint captures my-captures --json -",
        "meshpoint captures wheel.csv -o wheel.log",
        "meshpoint captures adc.csv --teeth 60 --missing 58,59 --threshold 2 -o a.log",
    ),
    "show": (
        "meshpoint show gearbox truck12",
        "meshpoint show settings",
        "meshpoint show calibration box.toml",
        "meshpoint show messages ValveCommand",
    ),
    "show gearbox": ("meshpoint show gearbox truck12", "meshpoint show gearbox --toml > own.toml"),
    "show settings": (
        "meshpoint show settings limits",
        "meshpoint show settings --toml > own.toml",
    ),
    "show calibration": ("meshpoint show calibration box.toml --gearbox truck12",),
    "show messages": (
        "meshpoint show messages",
        "meshpoint show messages ValveCommand",
        "meshpoint show messages --path",
    ),
    "help": (
        "meshpoint help simulate",
        "meshpoint help bus",
        "meshpoint help completion bash > ~/.meshpoint-completion.bash",
    ),
}
"""The end of each command's help."""


class HelpFormatter(argparse.HelpFormatter):
    """Fills paragraphs, but leaves a text with indented lines as it was laid out; a short usage."""

    def add_usage(
        self,
        usage: str | None,
        actions: Iterable[argparse.Action],
        groups: Iterable[Any],
        prefix: str | None = None,
    ) -> None:
        """Many options become one word."""
        shown = [action for action in actions if action.help != argparse.SUPPRESS]
        if usage is None and sum(bool(action.option_strings) for action in shown) > MOST_IN_USAGE:
            options = argparse.Action([], "options", nargs="?", metavar="options")
            shown = [options, *(action for action in shown if not action.option_strings)]
            groups = ()
        super().add_usage(usage, shown, groups, prefix)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n  " in text:
            return "\n".join(indent + line for line in text.splitlines())
        return super()._fill_text(text, width, indent)


class Parser(argparse.ArgumentParser):
    """A parser whose errors say what is wrong and where help is, without the usage's ten lines; its
    help ends with the examples of its command."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        lines = EXAMPLES.get(options.get("prog", "").removeprefix("meshpoint "))
        own: dict[str, Any] = {"formatter_class": HelpFormatter}
        if lines is not None:
            own |= {"epilog": examples(*lines)}
        super().__init__(*arguments, **(own | options))

    def error(self, message: str) -> NoReturn:
        """Ends with exit code 2 and one line: what was found, what is allowed, and a hint. Many
        allowed words take more lines, of 80 columns."""
        said = f"{self.prog}: error: {_nearest(message)}{message} (help: {self.prog} -h)"
        if "choose from" in message:
            said = folded(said)
        self.exit(Exit.BAD_INPUT, f"{said}\n")


def _nearest(message: str) -> str:
    """What a mistyped word may have been, of argparse's words about a wrong choice."""
    found = re.search(r"invalid choice: '([^']+)' \(choose from (.*)\)", message)
    near = found and get_close_matches(found[1], re.findall(r"[\w.-]+", found[2]), 1)
    return f"did you mean {near[0]}? " if near else ""


def examples(*lines: str) -> str:
    """The end of a command's help: command lines to copy."""
    title = "example:" if len(lines) == 1 else "examples:"
    return "\n  ".join((title, *lines))


def subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The commands of a parser by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}
