"""`meshpoint help completion`: what a shell needs to complete our command lines."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from meshpoint.cli.parsing import subparsers
from meshpoint.controller.settings.settings import STRATEGY_NAMES
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.rig_sim.settings import Profile

SHELLS: Final = ("bash", "zsh", "fish")
ZSH: Final = "autoload -U +X bashcompinit && bashcompinit\n"
"""Lets zsh take bash's way of completing."""
NAMED: Final[dict[str, tuple[str, ...]]] = {
    "as_built": tuple(str(profile) for profile in Profile),
    "gearbox": SHEET_NAMES,
    "strategies": tuple(STRATEGY_NAMES),
    "strategy": tuple(STRATEGY_NAMES),
}
"""Arguments whose value is one of these names, or a file, by what they are kept as."""


def script(shell: str, parser: argparse.ArgumentParser, summaries: Mapping[str, str]) -> str:
    """The script for one of SHELLS that completes the parser's commands, each with its summary."""
    commands = _commands(parser, summaries)
    if shell == "fish":
        return _fish(commands)
    return (ZSH if shell == "zsh" else "") + _bash(commands)


class Option(NamedTuple):
    """An option of a command."""

    names: tuple[str, ...]
    takes_file: bool
    """Whether its value may be a file, or any text."""
    choices: tuple[str, ...]
    """Names that its value may be."""


class Command(NamedTuple):
    """A command, its options, and the words that may follow it."""

    name: str
    summary: str
    options: tuple[Option, ...]
    words: tuple[str, ...]


def _commands(parser: argparse.ArgumentParser, summaries: Mapping[str, str]) -> list[Command]:
    """Every command of the parser; options of inner commands (`show gearbox`) are its own."""
    found, parsers = [], subparsers(parser)
    for name, summary in summaries.items():
        inner = subparsers(parsers[name])
        options = tuple(
            option for one in (parsers[name], *inner.values()) for option in _options(one)
        )
        words = (*inner, *_positional(parsers[name]))
        if name == "help":
            words = ("bus", "completion", *(one for one in summaries if one != name))
        found.append(Command(name, summary, options, words))
    return found


def _options(parser: argparse.ArgumentParser) -> Iterator[Option]:
    for action in parser._actions:
        if action.option_strings and action.dest != "until_eof":
            takes_file = action.nargs != 0 and not action.choices
            yield Option(tuple(action.option_strings), takes_file, _names(action))


def _names(action: argparse.Action) -> tuple[str, ...]:
    return tuple(map(str, action.choices or NAMED.get(action.dest, ())))


def _positional(parser: argparse.ArgumentParser) -> list[str]:
    """The values of arguments without a dash that are names."""
    return [
        name
        for action in parser._actions
        if not action.option_strings and not isinstance(action, argparse._SubParsersAction)
        for name in _names(action)
    ]


def _bash(commands: list[Command]) -> str:
    values, words = [f'    help:completion) words="{" ".join(SHELLS)}" ;;'], []
    for command in commands:
        for option in command.options:
            pattern = "|".join(f"{command.name}:{name}" for name in option.names)
            offered = f'words="{" ".join(option.choices)}"' if option.choices else ""
            offered += " files=1" if option.takes_file else ""
            if offered:
                values.append(f"    {pattern}) {offered.strip()} ;;")
        names = " ".join(name for option in command.options for name in option.names)
        words.append(f'    {command.name}) words="{" ".join(command.words)}" options="{names}" ;;')
    listed = " ".join(command.name for command in commands)
    return f"""\
_meshpoint() {{
  local cur=${{COMP_WORDS[COMP_CWORD]}} prev=${{COMP_WORDS[COMP_CWORD-1]}}
  local command= word words= options= files=
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    if [[ $word != -* ]]; then command=$word; break; fi
  done
  case $command:$prev in
{chr(10).join(values)}
  esac
  if [[ -z $words && -z $files ]]; then
    case $command in
    "") words="{listed}" options="--help --version" ;;
{chr(10).join(words)}
    esac
    if [[ $cur == -* ]]; then words=$options; elif [[ -n $command ]]; then files=1; fi
  fi
  COMPREPLY=($(compgen -W "$words" -- "$cur"))
  if [[ -n $files ]]; then COMPREPLY+=($(compgen -f -- "$cur")); fi
  return 0
}}
complete -o filenames -F _meshpoint meshpoint
"""


def _fish(commands: list[Command]) -> str:
    lines = [
        "complete -c meshpoint -n __fish_use_subcommand -l version -l help",
        "complete -c meshpoint -n '__fish_seen_subcommand_from completion' "
        f"-a '{' '.join(SHELLS)}'",
    ]
    for command in commands:
        summary = command.summary.replace("\\", "\\\\").replace("'", "\\'")
        lines.append(
            f"complete -c meshpoint -f -n __fish_use_subcommand -a {command.name} -d '{summary}'"
        )
        seen = f"complete -c meshpoint -n '__fish_seen_subcommand_from {command.name}'"
        if command.words:
            lines.append(f"{seen} -a '{' '.join(command.words)}'")
        for option in command.options:
            names = " ".join(
                f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}"
                for name in option.names
            )
            value = " -r" if option.takes_file else ""
            if option.choices:
                value = f"{value or ' -x'}a '{' '.join(option.choices)}'"
            lines.append(f"{seen} {names}{value}")
    return "\n".join(lines) + "\n"
