"""Runs that are recorded once and repeated by the tests: what they are, how one is made, what is
kept of it.

    python tests/closed_loop/recorded_runs.py [NAME ...]

makes the records of all runs, or of those named, anew (`make digests`): after a change that is
meant to change what a shift does, and after nothing else.

Matrices are multiplied by what OpenBLAS has for the processor at hand, which differs in the last
bit from processor to processor. So runs are made in a process that is told to use what every x86-64
has. With that, all frames were the same with kernels compiled for a processor without AVX and FMA,
and with numpy and the C library kept from using them (`NUMBA_CPU_NAME=generic`,
`NPY_DISABLE_CPU_FEATURES`, `GLIBC_TUNABLES`).
"""

from __future__ import annotations

import hashlib
import json
import lzma
import os
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from meshpoint.bench.bench import BenchCore, plan_shifts
from meshpoint.bench.bench_builder import virtual_bench
from meshpoint.bench.pauses import pauses_of
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import LAYSHAFT_RAD_S
from meshpoint.bus.classic.cores import bench_unpacker
from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.bus.profile import WireProfile
from meshpoint.controller.core.core import OWN_ADDRESS, ControllerCore
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import RigFault
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.wheels import Mesh
from meshpoint.results.monitor import RowMonitor
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.orders import FaultOrder, ScheduledFault
from meshpoint.rig_sim.settings import Preset, Profile

RECORD: Final = Path(__file__).with_name("recorded_runs.toml")
TRANSCRIPTS: Final = Path(__file__).with_name("recorded")
PART_US: Final = 100_000
"""A digest is of the frames of so much bus time."""
DIGEST_BYTES: Final = 4
ANY_PROCESSOR: Final = {"OPENBLAS_CORETYPE": "Prescott"}
LONGEST_US: Final = 40_000_000
THESIS, TRUCK12 = load_sheet("thesis"), load_sheet("truck12")
WHOLE = replace(THESIS, name="whole", main=replace(THESIS.main, second=Mesh(37, 48)))
"""Gear 10 has as many teeth as dog teeth: its phase is known again once the wheels' teeth are."""
PLAIN: Final = ControllerSettings()


def fault(at_ms: int, kind: RigFault, target: int, value: float, for_ms: int) -> ScheduledFault:
    return ScheduledFault(1000 * at_ms, FaultOrder(kind, target, value, 1000 * for_ms))


def made(**other: Any) -> Setup:
    """A run of two shifts of the same pair: the second one knows its gear's phase, and aims. By the
    driveline behind the gearbox it aims only after some more (`typical_on_and_on`)."""
    usual = {"sheet": TRUCK12, "settings": PLAIN, "shifts": 2, "pairs": ((8, 10),)}
    return Setup(**(usual | other))  # type: ignore[arg-type]


RUNS: Final[dict[str, Setup]] = {
    "preset_thesis": made(sheet=THESIS, preset=Preset.THESIS, seed=1),
    "clean_thesis": made(sheet=THESIS, profile=Profile.CLEAN, seed=7),
    "clean_up_and_down": made(profile=Profile.CLEAN, seed=7, shifts=4,
                              pairs=((10, 8), (7, 8), (8, 10), (6, 7))),
    "torsion": made(profile=Profile.CLEAN, seed=4, as_built={
        "driveline.stiffness_nm_rad": 20_000.0, "driveline.damping_nms": 20.0}),
    "typical_1": made(seed=1),
    "typical_2": made(seed=2, pairs=((12, 10),)),
    "typical_3": made(seed=3, pairs=((5, 7),)),
    "typical_on_and_on": made(seed=4, shifts=7),
    "harsh": made(profile=Profile.HARSH, seed=2),
    "faulted_sensors": made(profile=Profile.CLEAN, seed=5, faults=(
        fault(500, RigFault.HALL_MISSING_TOOTH, 2, 3.0, 300),
        fault(1_900, RigFault.HALL_NOISE_BURST, 2, 4.0, 200),
        fault(2_100, RigFault.POSITION_FROZEN, 0, 0.0, 200))),
    "faulted_valves": made(profile=Profile.CLEAN, seed=6, faults=(
        fault(850, RigFault.SLEEVE_JAMMED, 0, 0.0, 400),
        fault(1_900, RigFault.SUPPLY_DROP, 0, 4.0, 1_000))),
    "faulted_node": made(profile=Profile.CLEAN, seed=8, faults=(
        fault(800, RigFault.NODE_RESTART, 0, 0.0, 200),
        fault(1_800, RigFault.CLOCK_STEP, 0, 1e6, 300))),
    "restarted": made(sheet=WHOLE, profile=Profile.CLEAN, seed=12),
    "thesis_filter": made(sheet=THESIS, settings=ControllerSettings(estimator_name="thesis"),
                          profile=Profile.CLEAN, seed=10),
    "window_speed": made(settings=ControllerSettings(
        estimator_name="window", strategy_name="speed_window_anticipating"), seed=11, shifts=1),
    "loaded_bus": made(seed=4, bus_load=0.8, shifts=1),
    "immediate_valves": made(settings=ControllerSettings(valve_timing="immediate"),
                             profile=Profile.CLEAN, seed=9),
    "classic_bus": made(profile=Profile.CLEAN, seed=3, wire=WireProfile.CLASSIC),
}  # fmt: skip
TRANSCRIBED: Final = ("clean_thesis", "typical_1", "faulted_node")
"""Of these all that the controller heard is kept as well: it is repeated without a rig."""


LONG: Final = ("typical_2", "typical_3", "typical_on_and_on")
"""As `typical_1`, with other gears and more shifts: repeated by `make long`."""
OF_CHECK: Final = (
    "clean_up_and_down", "torsion", "harsh", "faulted_sensors", "faulted_valves", "restarted",
    "thesis_filter", "window_speed", "loaded_bus",
)  # fmt: skip
"""Repeated by `make check`; those in neither tuple by `make test`."""
RESTARTED: Final = "restarted"
"""Made twice: the second time the controller begins with what it had learned the first time. The
second one is what is recorded."""


class AnyVersion(RunHeader):
    """A header whose hash does not change with version, DBC and settings: the status frames of a
    record tell it."""

    @property
    def run_hash(self) -> int:
        return 0


def controller_of(setup: Setup) -> ControllerCore:
    return ControllerCore(AnyVersion(**vars(setup.header)))


class Transcript(AroundCore[Core]):
    """Writes down what a core heard (<), when it was stepped (@), what it then sent (>), and when
    it asked to be stepped again (=)."""

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.lines: list[str] = []

    def receive(self, frame: Frame) -> None:
        self.lines.append(f"< {words(frame)}")
        super().receive(frame)

    def step(self, now_us: int) -> Step:
        step = super().step(now_us)
        self.lines.append(f"@ {now_us}")
        self.lines += (f"> {words(frame)}" for frame in step.frames)
        self.lines.append(f"= {self.next_step_us}")
        return step


def words(frame: Frame) -> str:
    """As candump writes a frame."""
    return f"{frame.can_id:08X}{'##1' if frame.is_fd else '#'}{frame.data.hex().upper()}"


def frame_of(text: str) -> Frame:
    can_id, content = text.split("#", 1)
    is_fd = content.startswith("#")
    return Frame(int(can_id, 16), bytes.fromhex(content[2:] if is_fd else content), is_fd)


def first_difference(core: Core, lines: Sequence[str]) -> str | None:
    """Gives a core what a transcript says that it heard, when it was stepped then. Says at which
    step it first sends another frame, or asks for another time; None where it never does."""
    again, now_us = Transcript(core), 0
    for i, line in enumerate(lines):
        sign, text = line.split(" ")
        if sign == "@":
            now_us = int(text)
            again.step(now_us)
        elif sign == "<":
            again.receive(frame_of(text))
        if again.lines[i] != line:
            return f"at {now_us} us of its clock: now {again.lines[i]!r}, recorded is {line!r}"
    return None


@dataclass
class Run:
    """What is kept of a run: digests of each tenth of a second, and what a person reads."""

    controller: list[str] = field(default_factory=list)
    """Of the frames that the controller sent."""
    others: list[str] = field(default_factory=list)
    """Of all others, the rig's and the operator's."""
    events: list[str] = field(default_factory=list)
    """The controller's log, with bus time in ms."""
    shifts: list[str] = field(default_factory=list)

    def to_toml(self, name: str) -> str:
        digests = (f'{side} = "{" ".join(getattr(self, side))}"' for side in DIGESTS)
        lists = (
            f"{key} = [\n" + "".join(f"    {line!r},\n" for line in getattr(self, key)) + "]"
            for key in ("events", "shifts")
        )
        return "\n".join((f"[{name}]", *digests, *lists)) + "\n"


DIGESTS: Final = ("controller", "others")


def made_again(name: str) -> tuple[Run, Transcript]:
    """The run of this name."""
    setup = RUNS[name]
    if name == RESTARTED:
        core = controller_of(setup)
        run(setup, core)
        setup = replace(setup, calibration=core.calibration("recorded"))
    return run(setup, controller_of(setup))


def run(setup: Setup, core: ControllerCore) -> tuple[Run, Transcript]:
    """A run with this controller, and all that it heard and sent."""
    plan = plan_shifts(setup.sheet, list(setup.pairs), setup.shifts, LAYSHAFT_RAD_S)
    operator = BenchCore(plan, pauses_of(setup.sheet, setup.profile, setup.preset))
    rig, controller = RigCore(setup.sheet, setup.rig(plan[0])), Transcript(core)
    parts = [defaultdict[int, Any](hashlib.sha256) for _ in DIGESTS]
    found, monitor, unpacker = Run(), RowMonitor(setup.sheet, setup.settings), bench_unpacker()

    def take(time_us: int, frame: Frame) -> None:
        content = f"{time_us} {words(frame)}".encode()
        parts[frame.can_id & 0xFF != OWN_ADDRESS][time_us // PART_US].update(content)
        for heard in (frame,) if setup.wire is WireProfile.FD else unpacker.take(frame):
            monitor.take(heard)

    def log(time_us: int, node: int, line: str) -> None:
        found.events += [f"{time_us // 1000} {line}"] if node == 0 else []

    bench = virtual_bench(setup, controller, rig, operator, on_frame=take, on_event=log)
    assert bench.time.run(lambda: operator.done, LONGEST_US)
    ends = range(1 + bench.time.now_us // PART_US)
    for side, digests in zip((found.controller, found.others), parts, strict=True):
        side += (digests[part].hexdigest()[: 2 * DIGEST_BYTES] for part in ends)
    found.shifts += map(reported, monitor.rows.rows)
    return found, controller


def reported(row: ShiftRow) -> str:
    """A shift in a line: the rig's truth of how it met its gear beside the controller's word."""
    met = f"{row.contact} at {row.phase_error_deg:.3f} deg" if row.contact else "no contact"
    return (
        f"{row.from_} -> {row.to} {row.result} by {row.strategy} ({row.fault}), "
        f"{row.attempts} fired, {row.duration_ms:.3f} ms, {met}"
    )


def recorded() -> dict[str, Run]:
    """The records as they are kept."""
    found = {}
    for name, values in tomllib.loads(RECORD.read_text(encoding="utf-8")).items():
        digests = (values[side].split(" ") for side in DIGESTS)
        found[name] = Run(*digests, values["events"], values["shifts"])
    return found


def transcript_of(name: str) -> list[str]:
    """What the controller of a run heard, did and sent, as it is kept."""
    return lzma.decompress((TRANSCRIPTS / f"{name}.xz").read_bytes()).decode().splitlines()


def repeated(names: Sequence[str]) -> dict[str, tuple[Run, str | None]]:
    """Runs made once more, and of those whose controller is repeated alone where it differs."""
    command = [sys.executable, __file__, "--repeat", *names]
    environment = os.environ | ANY_PROCESSOR
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    return {name: (Run(**made), found) for name, (made, found) in json.loads(done.stdout).items()}


def repeat(names: list[str]) -> None:
    """Reports `repeated`, on standard output."""
    found = {}
    for name in names:
        alone = None
        if name in TRANSCRIBED:
            alone = first_difference(controller_of(RUNS[name]), transcript_of(name))
        found[name] = asdict(made_again(name)[0]), alone
    print(json.dumps(found))


def record(names: list[str]) -> None:
    """Makes the records of these runs anew."""
    kept = recorded() if RECORD.exists() else {}
    for name in names or RUNS:
        kept[name], controller = made_again(name)
        print(f"{name}: {len(kept[name].controller) / 10} s, {kept[name].shifts}", flush=True)
        if name in TRANSCRIBED:
            content = lzma.compress("\n".join(controller.lines).encode(), preset=9)
            (TRANSCRIPTS / f"{name}.xz").write_bytes(content)
    text = "\n".join(kept[name].to_toml(name) for name in RUNS if name in kept)
    RECORD.write_text(f"# Made by `make digests`: see recorded_runs.py.\n\n{text}", "utf-8")


if __name__ == "__main__":
    if not ANY_PROCESSOR.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ANY_PROCESSOR)
    if sys.argv[1:2] == ["--repeat"]:
        repeat(sys.argv[2:])
    else:
        record(sys.argv[1:])
