"""A log whose clock is not the sensors': what is read from it is what the same log by their clock
says, and each reader says what it did. What does not fit is refused, with the reason."""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import json
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from meshpoint.base.exits import Exit
from meshpoint.bus.logs.files import read_logs
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.cli.main import main
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.identify.brake_figures import BRAKE_FIGURES
from meshpoint.logs.log_clock import LogClock, LogClockFit

SHIFTS = 6
Frames = list[tuple[float, Frame]]
EDGES = {codec.spec.can_id for name, codec in CODECS.items() if name.startswith("Edges")}
VALVES = CODECS["ValveCommand"].spec.can_id
STEADY = "the log's clock runs 1.0020 x the sensors'; its stamps are taken in sensor time"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six shifts in virtual time: its stamps are the sensors' but for the frames' way."""
    path = tmp_path_factory.mktemp("clock") / "run.log"
    assert main(["simulate", "--gearbox", "thesis", "--as-built", "clean", "--seed", "5",
                 "--shifts", str(SHIFTS), "--log", str(path)]) == 0  # fmt: skip
    return path


def rewritten(log: Path, name: str, change: Callable[[Frames], Frames]) -> Path:
    path = log.with_name(name)
    with LogWriter(path, flush_every_s=None) as writer:
        for time_s, frame in change(list(read_logs([log]))):
            writer.write(time_s, frame)
    return path


def stretched(rate: float) -> Callable[[Frames], Frames]:
    return lambda frames: [(1.7e9 + rate * time_s, frame) for time_s, frame in frames]


def waited_for(frames: Frames) -> Frames:
    """By the wall clock of a machine on which bus time waits, mostly a little, now and then for
    long; and each frame comes up to 2 ms late, in its order."""
    draw = random.Random(5)
    made, wall_s, bus_s, newest_s = [], 1.7e9, frames[0][0], 0.0
    slow, until_s = 1.0, 0.0
    for time_s, frame in frames:
        if time_s >= until_s:
            slow, until_s = draw.choice((1.0, 1.0, 1.3, 1.5, 2.5)), time_s + draw.uniform(0.02, 0.5)
        wall_s += slow * (time_s - bus_s)
        if draw.random() < 0.0005:
            wall_s += draw.uniform(0.02, 0.3)
        bus_s = time_s
        newest_s = max(newest_s, wall_s + draw.uniform(0.0, 0.002))
        made.append((newest_s, frame))
    return made


@pytest.fixture(scope="module")
def others(log: Path) -> dict[str, Path]:
    """The same log by other clocks."""
    return {
        "steady": rewritten(log, "steady.log", stretched(1.002)),
        "uneven": rewritten(log, "uneven.log", waited_for),
    }


Reported = Callable[[str, Path], tuple[dict[str, Any], str]]


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Reported:
    """JSON and words, on one line, of a command on a log; each is run once."""
    path = tmp_path_factory.mktemp("reported") / "reported.json"

    @functools.cache
    def tell(command: str, log: Path) -> tuple[dict[str, Any], str]:
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            assert main([*command.split(), str(log), "--json", str(path)]) == 0
        return json.loads(path.read_text()), " ".join(said.getvalue().split())

    return tell


def clock_of(frames: Frames) -> LogClock:
    fit = LogClockFit()
    for time_s, frame in frames:
        fit.take(time_s, frame)
    return fit.finish()


@pytest.mark.parametrize("by", ["steady", pytest.param("uneven", marks=pytest.mark.long)])
def test_the_gearbox_is_the_one_of_the_log_by_the_sensors_clock(
    log: Path, others: dict[str, Path], by: str, reported: Reported
) -> None:
    (good, _), (found, _) = reported("identify", log), reported("identify", others[by])
    assert not good["log_clock"]["differs"]
    assert found["log_clock"]["parts"][0]["kind"] == by
    for one, other in zip(good["figures"], found["figures"], strict=True):
        assert one["name"] == other["name"]
        if one["value"] is None:
            continue
        assert other["value"] is not None, (one, other)
        # Both are estimates: their intervals have to have a value in common.
        assert one["low"] <= other["high"] and other["low"] <= one["high"], (one, other)
    assert any(figure["name"] == "sleeve delay second" and figure["value"] is not None
               for figure in found["figures"])  # fmt: skip


@pytest.mark.parametrize("by", ["steady", pytest.param("uneven", marks=pytest.mark.long)])
def test_every_request_is_decided_as_by_the_sensors_clock(
    log: Path, others: dict[str, Path], by: str, reported: Reported
) -> None:
    good = reported("replay --sensors", log)[0]["decisions"]
    found, _ = reported("replay --sensors", others[by])
    assert len(good) == SHIFTS
    same = ("from", "to", "status", "fault", "strategy", "reference")
    assert [[row[key] for key in same] for row in found["decisions"]] == [
        [row[key] for key in same] for row in good
    ]
    assert found["log_clock"]["differs"]


@pytest.mark.parametrize("by", ["steady", "uneven"])
def test_a_story_is_reported_at_the_seconds_of_the_sensors_clock(
    log: Path, others: dict[str, Path], by: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def story(path: Path) -> list[dict[str, Any]]:
        assert main(["tell", str(path), "--json"]) == 0
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    good, (clock, *lines) = story(log), story(others[by])
    assert clock["who"] == "bus"
    assert clock["words"].endswith("its stamps are taken in sensor time")
    assert [line["words"] for line in lines] == [line["words"] for line in good]
    for line, same in zip(lines, good, strict=True):
        assert line["at_s"] == pytest.approx(same["at_s"], abs=0.014), (line, same)


def test_a_watched_log_has_its_messages_in_their_cycle(
    others: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", "--speed", "0", str(others["uneven"])]) == 0
    said = capsys.readouterr()
    rates = [int(rate) for rate in re.findall(r"\bEdges\w+ +(\d+)/s", said.out)]
    assert len(rates) >= 6
    assert all(98 <= rate <= 102 for rate in rates), said.out
    assert "its stamps are taken in sensor time" in said.err


@pytest.mark.parametrize("command", ["identify", "replay --gap-rate", "replay", "replay --sensors"])
def test_each_reader_says_what_it_did_with_the_clock(
    others: dict[str, Path], command: str, reported: Reported
) -> None:
    found, said = reported(command, others["steady"])
    assert found["log_clock"]["said"] == STEADY
    assert STEADY in said


def test_a_log_by_another_clock_is_verified_to_the_byte(
    others: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(others["uneven"]), "--verify"]) == 0
    assert "identical: " in capsys.readouterr().out


@pytest.mark.parametrize("off_ppm", [-2000.0, -100.0, 0.1, 100.0, 1000.0])
def test_the_rate_of_a_steady_clock_is_found_whatever_delays_its_frames(
    log: Path, off_ppm: float
) -> None:
    """Delays of a millisecond in the mean, and every two seconds or so one of 40 ms, behind which
    the others wait. A tenth of a ppm is a microsecond in this log, and is none."""
    draw, newest_s, frames = random.Random(2), 0.0, []
    for time_s, frame in read_logs([log]):
        late_s = draw.expovariate(1000.0) + (0.04 if draw.random() < 0.0004 else 0.0)
        newest_s = max(newest_s, (1.0 + off_ppm * 1e-6) * time_s + late_s)
        frames.append((newest_s, frame))
    (part,) = clock_of(frames).parts
    if abs(off_ppm) < 1.0:
        assert part.kind == "alike"
    else:
        assert part.kind == "steady"
        assert (part.rate - 1.0) * 1e6 == pytest.approx(off_ppm, abs=30.0)


@pytest.mark.parametrize("seconds", [1.1, 1.5, 2.0])
def test_a_short_log_s_delays_are_not_taken_for_another_rate(log: Path, seconds: float) -> None:
    """One shift of a live run beside a busy machine."""
    run = list(read_logs([log]))
    short = [(time_s, frame) for time_s, frame in run if time_s - run[0][0] < seconds]
    for seed in range(30):
        draw, newest_s, frames = random.Random(seed), 0.0, []
        for time_s, frame in short:
            newest_s = max(newest_s, time_s + draw.expovariate(400.0))
            frames.append((newest_s, frame))
        (part,) = clock_of(frames).parts
        assert part.kind == "alike", f"seed {seed}: {part}"


def test_entries_in_sensor_time_are_as_far_apart_as_they_were_sent(log: Path) -> None:
    sent = list(read_logs([log]))
    frames = waited_for(sent)
    shown = list(clock_of(frames).in_sensor_time(frames))
    assert [frame for _, frame in shown] == [frame for _, frame in sent]
    off_s = [
        time_s - shown[0][0] - (was_s - sent[0][0])
        for (time_s, _), (was_s, _) in zip(shown, sent, strict=True)
    ]
    # Between two reads a wait may fall anywhere, so nothing is known better than their 10 ms; and
    # each read came up to 2 ms late.
    assert max(map(abs, off_s)) < 0.012
    assert all(later >= sooner for (sooner, _), (later, _) in itertools.pairwise(shown))


def test_stamps_by_the_sensors_clock_stay_to_the_last_digit(log: Path) -> None:
    frames = list(read_logs([log]))
    clock = clock_of(frames)
    assert not clock.differs
    assert clock.words == ""
    assert list(clock.in_sensor_time(frames)) == frames


def test_a_sensor_that_restarts_and_a_log_that_is_set_back_begin_a_part(log: Path) -> None:
    """Two runs behind each other, the second stamped as of an hour before, both by a clock that is
    1.002 x the sensors': no hour is taken for a drift."""
    run = list(read_logs([log]))
    frames = stretched(1.002)(run) + [(t - 3600.0, f) for t, f in stretched(1.002)(run)]
    clock = clock_of(frames)
    assert [part.kind.value for part in clock.parts] == ["steady", "steady"]
    assert all(part.rate == pytest.approx(1.002, abs=1e-5) for part in clock.parts)
    shown = [time_s for time_s, _ in clock.in_sensor_time(frames)]
    half = len(run)
    for part in (shown[:half], shown[half:]):
        assert part[-1] - part[0] == pytest.approx(run[-1][0] - run[0][0], abs=0.002)


def test_a_log_without_edge_frames_is_taken_as_it_is_and_that_is_said(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = rewritten(
        log, "no_edges.log", lambda frames: [(t, f) for t, f in frames if f.can_id not in EDGES]
    )
    said = "no edge frame reports the sensors' clock: the log's stamps are taken as they are"
    assert main(["tell", str(path)]) == 0
    assert said in capsys.readouterr().out
    frames = list(read_logs([path]))
    assert list(clock_of(frames).in_sensor_time(frames)) == frames


def test_activations_that_came_late_by_the_log_s_clock_are_not_called_missing(
    log: Path, reported: Reported
) -> None:
    path = rewritten(
        log,
        "late.log",
        lambda frames: [(t, f) for t, f in waited_for(frames) if f.can_id not in EDGES],
    )
    figures = {figure["name"]: figure for figure in reported("identify", path)[0]["figures"]}
    assert figures["sleeve delay second"]["value"] is None
    assert figures["sleeve delay second"]["why"].endswith(
        "commands came after their activation, by the log's clock"
    )


def test_figures_of_runs_that_no_equations_of_motion_fit_are_refused(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The valve commands end after a second: the brake acts in each run, and none asked for it."""
    begun_s = next(read_logs([log]))[0]
    path = rewritten(
        log,
        "silent.log",
        lambda frames: [(t, f) for t, f in frames if f.can_id != VALVES or t < begun_s + 1.0],
    )
    capsys.readouterr()
    assert main(["identify", str(path), "--json", "-"]) == Exit.NOT_DECIDED
    found = json.loads(capsys.readouterr().out)
    assert "1 is expected and 30 allowed" in found["refused"]
    for figure in found["figures"]:
        if figure["name"] in BRAKE_FIGURES:
            assert figure["value"] is figure["low"] is figure["high"] is None
            assert figure["why"] == "refused, no equations of motion fit the runs"
    # The teeth's errors come from the edges alone.
    teeth = [one for one in found["figures"] if "wheel" in one["name"]]
    assert teeth
    assert all(one["value"] is not None for one in teeth)


def test_one_damaged_edge_frame_does_not_move_the_clock(log: Path) -> None:
    frames = list(read_logs([log]))
    at = next(i for i, (_, frame) in enumerate(frames) if i > 9000 and frame.can_id in EDGES)
    time_s, frame = frames[at]
    # Read 20 ms later than it came, by the damaged bytes.
    read_us = (int.from_bytes(frame.data[3:7], "little") + 20_000) & 0xFFFF_FFFF
    damaged = frame.data[:3] + read_us.to_bytes(4, "little") + frame.data[7:]
    frames[at] = (time_s, frame._replace(data=damaged))
    assert not clock_of(frames).differs
