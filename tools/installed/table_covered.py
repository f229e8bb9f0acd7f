"""Has every command of README's table run?  table_covered.py README.md FILE

FILE has a line for each run: the command's arguments. A command of the table is covered by a run
that has all its words but the numbers and the placeholders (LOG, FILE, DIR), in any order.
Exit code 1, and the commands that did not run, otherwise.
"""

import re
import sys
from pathlib import Path

HEADING = "## Commands"


def commands(readme: str) -> list[str]:
    """Every `meshpoint ...` in the first column of the table below the heading."""
    table = readme.split(HEADING, 1)[1].split("\n## ", 1)[0]
    cells = [line.split("|")[1] for line in table.splitlines() if line.startswith("| ")]
    return [command for cell in cells for command in re.findall(r"`meshpoint ([^`]+)`", cell)]


def uncovered(wanted: list[str], ran: list[str]) -> list[str]:
    """The commands of which no run has all the words that count."""
    runs = [set(line.split()) for line in ran]
    return [command for command in wanted if not any(_words(command) <= run for run in runs)]


def _words(command: str) -> set[str]:
    return {word for word in command.split() if not re.fullmatch(r"[\d.]+|[A-Z_]+", word)}


if __name__ == "__main__":
    wanted = commands(Path(sys.argv[1]).read_text(encoding="utf-8"))
    missed = uncovered(wanted, Path(sys.argv[2]).read_text(encoding="utf-8").splitlines())
    for command in missed:
        print(f"of README's table, did not run: meshpoint {command}", file=sys.stderr)
    sys.exit(bool(missed) or not wanted)
