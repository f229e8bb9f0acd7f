"""Damaged files of every format that people name: `fuzz_files.py COUNT [SEED] [FORMAT ...]`.

Bytes are damaged as files are, and values replaced by ones that are hard to read: not finite, huge,
negative, of another type, deeply nested. A file is read, or refused with the error of its kind that
names it; anything else that is raised is a crash, and so is a reading that takes seconds.
"""

from __future__ import annotations

import io
import json
import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from log_mutations import damaged, mixed_log

from meshpoint.base.errors import CommandError
from meshpoint.bus.authentication.frames import AUTHENTICATION_DBC
from meshpoint.bus.command_keys import load_keys
from meshpoint.bus.logs.reader import FORMATS, LogError, read_log
from meshpoint.bus.pace import PaceError, PaceFile
from meshpoint.campaigns import stored
from meshpoint.campaigns.columns import ShiftColumns
from meshpoint.cli.main import main as meshpoint
from meshpoint.cli.show_gearbox import sheet_toml
from meshpoint.cli.show_settings import settings_toml
from meshpoint.controller.run.kept import read_file
from meshpoint.controller.settings.header import HeaderError, header_name, load_header, new_header
from meshpoint.controller.settings.settings import ControllerSettings, load_settings_file
from meshpoint.dbc.schema import SchemaError, parse_schema
from meshpoint.dbc.source import DBC_CONTENT
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.gearbox.tables import TableError
from meshpoint.logs.capture_files import read_columns
from meshpoint.rig_sim.truck.as_built import draw_as_built, load_as_built
from meshpoint.rig_sim.truck.scenario import load_scenario

SLOW_S = 20.0
"""Of processor time; the largest of these files is read in a hundredth of that."""
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
HARD = (
    b"nan", b"inf", b"-inf", b"1e400", b"-1e400", b"0", b"-1", b"-0.0", b"1" * 30, b"1" * 5000,
    b"1e-320", b"true", b'""', b'"x"', b"[]", b"[[[[[[]]]]]]", b"{}", b"null", b"0x7fffffff",
    b"2024-01-01", b"\xff\xfe", b"\x00", b"[" * 3000, b"a" * 70_000, "ü\u2028".encode(),
)  # fmt: skip


@dataclass(frozen=True)
class Format:
    """One kind of file: how it is named, what a good one holds, how it is read."""

    name: str
    good: Callable[[Path], bytes]
    """Makes the content; the folder is for those that must write it."""
    read: Callable[[Path], object]
    errors: tuple[type[Exception], ...]


def learned(folder: Path) -> bytes:
    path = folder / "learned.toml"
    run = ["simulate", "--preset", "thesis", "--shifts", "1", "--json", str(folder / "run.json")]
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        code = meshpoint([*run, "--calibration", str(path)])
    if code != 0:
        raise RuntimeError("no calibration was learned")
    return path.read_bytes()


HEADER = new_header("1", load_sheet("thesis"), ControllerSettings())


def read_header(path: Path) -> object:
    named = path.parent / header_name(HEADER.run_hash)
    named.write_bytes(path.read_bytes())
    return load_header(path.parent, HEADER.run_hash)


def as_built_json(_folder: Path) -> bytes:
    groups: dict[str, dict[str, float]] = {}
    for name, value in draw_as_built(3, {}).values.items():
        group, _, key = name.partition(".")
        groups.setdefault(group, {})[key] = value
    return json.dumps({"as_built": groups}).encode()


def a_log(ending: str) -> Callable[[Path], bytes]:
    def make(folder: Path) -> bytes:
        path = folder / f"good{ending}"
        mixed_log(path, 60)
        return path.read_bytes()

    return make


def capture_csv(_folder: Path) -> bytes:
    times = [k * 1e-3 + (5e-4 if k % 2 else 0.0) for k in range(300)]
    return b"time,level\n" + b"".join(b"%.6f,%d\n" % (t, k % 2) for k, t in enumerate(times))


def part_parquet(folder: Path) -> bytes:
    path = folder / "part.parquet"
    pq.write_table(pa.Table.from_pylist([], schema=stored.schema()), path)
    return path.read_bytes()


def read_part(path: Path) -> object:
    columns = ShiftColumns()
    stored.read_shifts(path, columns)
    return columns.all()


def keys_toml(_folder: Path) -> bytes:
    names = ("valve_command", "clutch_command", "engine_request")
    return "".join(f'{name} = "{k:032x}"\n' for k, name in enumerate(names)).encode()


def read_keys(path: Path) -> object:
    path.chmod(0o600)
    return load_keys(path)


SCENARIO = b"""[[fault]]
kind = "valve_stuck"
at_ms = 500
for_ms = 200.5
target = 1
value = 1.0

[[fault]]
kind = "supply_drop"
at_ms = 900
value = 3.5
"""

FILES = (
    *(Format(f"x{e}", a_log(e), lambda p: list(read_log(p)), (LogError,)) for e in FORMATS),
    Format("settings.toml", lambda _: settings_toml().encode(), load_settings_file, (TableError,)),
    *(
        Format(
            f"{name}.sheet.toml",
            lambda _, name=name: sheet_toml(load_sheet(name)).encode(),
            load_sheet,
            (TableError,),
        )
        for name in SHEET_NAMES
    ),
    Format(
        "calibration.toml", learned, lambda p: read_file(p, load_sheet("thesis")), (TableError,)
    ),
    Format("scenario.toml", lambda _: SCENARIO, load_scenario, (TableError,)),
    Format("as_built.json", as_built_json, load_as_built, (TableError,)),
    Format("header.json", lambda _: HEADER.canonical().encode(), read_header, (HeaderError,)),
    Format("wire.dbc", lambda _: DBC_CONTENT, lambda p: parse_schema(p.read_bytes(), p.name),
           (SchemaError,)),
    Format("small.dbc", lambda _: AUTHENTICATION_DBC.read_bytes(),
           lambda p: parse_schema(p.read_bytes(), p.name), (SchemaError,)),
    Format("keys.toml", keys_toml, read_keys, (TableError,)),
    Format("capture.csv", capture_csv, read_columns, (CommandError,)),
    Format("part.parquet", part_parquet, read_part, (CommandError,)),
    Format("pace", lambda folder: _pace(folder), PaceFile, (PaceError, OSError)),
)  # fmt: skip
COSTLY = frozenset({"wire.dbc"})
"""Each takes half a second even when nothing is wrong: a twentieth of the others' number."""


def _pace(folder: Path) -> bytes:
    path = folder / "pace.good"
    PaceFile.create(path)
    return path.read_bytes()


def mutated(content: bytes, draw: random.Random) -> bytes:
    """One to three damages: of bytes, of values, of lines."""
    for _ in range(draw.choice((1, 1, 2, 3))):
        kind = draw.randrange(4) if content else 0
        if kind == 0 or not content:
            content = damaged(content, draw)[1] if content else draw.randbytes(9)
        elif kind == 1:
            places = list(NUMBER.finditer(content))
            if places:
                place = draw.choice(places)
                content = content[: place.start()] + draw.choice(HARD) + content[place.end() :]
        elif kind == 2:
            lines = content.splitlines(keepends=True)
            at, to = draw.randrange(len(lines)), draw.randrange(len(lines))
            lines[at : at + 1] = draw.choice(([], [lines[at]] * 2, [lines[to]]))
            content = b"".join(lines)
        else:
            at = draw.randrange(len(content))
            content = content[:at] + draw.choice(HARD) + content[at:]
    return content


def fuzz(one: Format, count: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Damages `count` copies; what came of them, and a line for each crash."""
    good, draw = one.good(folder), random.Random(f"{one.name} {seed}")
    path = folder / one.name
    found: Counter[str] = Counter()
    crashes = []
    for number in range(count):
        content = good if number == 0 else mutated(good, draw)
        path.unlink(missing_ok=True)
        path.write_bytes(content)
        began_s = time.process_time()
        try:
            one.read(path)
            found["read"] += 1
        except one.errors:
            found["refused"] += 1
            if number == 0:
                crashes.append(f"{one.name}: the good one was refused")
        except Exception as error:  # noqa: BLE001 (what this is for)
            found["crashed"] += 1
            crashes.append(
                f"{one.name} {seed}, copy {number}: {type(error).__name__}: {error}"[:300]
            )
        if time.process_time() - began_s > SLOW_S:
            crashes.append(f"{one.name} {seed}, copy {number}: took over {SLOW_S:g} s")
    return found, crashes


def main(argv: list[str]) -> int:
    """Each format this often; 1 where one crashed."""
    count, seed = int(argv[0]), int(argv[1]) if len(argv) > 1 else 1
    bad, total = 0, 0
    for one in FILES:
        if len(argv) > 2 and one.name not in argv[2:]:
            continue
        began_s, copies = time.monotonic(), max(2, count // 20) if one.name in COSTLY else count
        with tempfile.TemporaryDirectory() as folder:
            found, crashes = fuzz(one, copies, seed, Path(folder))
        total += copies
        bad += len(crashes)
        print(f"{one.name}: {dict(found)}, {time.monotonic() - began_s:.0f} s", flush=True)
        print("".join(f"    {line}\n" for line in crashes[:20]), end="", flush=True)
    print(f"{total} files, {bad} crashes")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
