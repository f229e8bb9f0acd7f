"""Open loop against the truth: the very same bench goes on with the other strategy instead.

Up to where a valve is first driven differently, a log holds all that the other strategy would have
seen: its decisions there are those of the branched bench, to the last digit.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from campaigns import small_spec

from meshpoint.base.version import product_version
from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.core.core import OWN_ADDRESS
from meshpoint.controller.settings.header import RunHeader, new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.replays import open_loop as open_loop_module
from meshpoint.replays.open_loop import SHIFTING, OpenLoop
from meshpoint.replays.replay import STATUS, LogReplay
from meshpoint.replays.session import Verification
from meshpoint.report.judged import Judged, judge
from meshpoint.report.trajectory import Trajectory, said
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.units import RPM

SHIFTS = 4
RECORDED, OTHER = "speed_window", "target_phase"


def judge_log(folder: Path, header: RunHeader, frames: list[Frame], other: str) -> list[Judged]:
    header.save(folder)
    open_loop = OpenLoop(
        lambda header: replace(header, settings=header.settings.with_strategy(other))
    )
    (session,) = LogReplay(folder, verify=True, onlooker=open_loop).run(frames)
    assert session.verdict is Verification.IDENTICAL, str(session)
    return list(open_loop.judged.values())


def frames_of(loop: ClosedLoop) -> list[Frame]:
    assert loop.log is not None
    return [frame for _, frame in loop.log]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[ClosedLoop], ClosedLoop, Path]:
    """One run with today's strategy, and from each of its requests on a run with the other one."""
    settings = ControllerSettings(strategy_name=RECORDED)
    spec = small_spec(Preset.THESIS, settings=settings)
    drawn = draw(15, spec.sheet, spec.preset, spec.pairs, SHIFTS + 1, {}, Profile.CLEAN)
    loop = ClosedLoop(spec.sheet, settings, spec.preset, drawn, log=[])
    branches = []
    for _ in range(SHIFTS):
        loop.prepare()
        branch = loop.fork()
        branch.use(replace(settings, strategy_name=OTHER), knows_all=False)
        branch.shift()
        branch.prepare()
        branches.append(branch)
        loop.shift()
    loop.prepare()
    return branches, loop, tmp_path_factory.mktemp("log")


@pytest.fixture(scope="module")
def header(bench: tuple[list[ClosedLoop], ClosedLoop, Path]) -> RunHeader:
    spec = small_spec(Preset.THESIS)
    settings = ControllerSettings(strategy_name=RECORDED)
    return new_header(product_version(), spec.sheet, settings)


@pytest.fixture(scope="module")
def judged(bench: tuple[list[ClosedLoop], ClosedLoop, Path], header: RunHeader) -> list[Judged]:
    """The log as the other strategy sees it."""
    _, loop, folder = bench
    return judge_log(folder, header, frames_of(loop), OTHER)


def test_it_decides_as_the_branched_bench_until_a_valve_is_driven_differently(
    bench: tuple[list[ClosedLoop], ClosedLoop, Path], header: RunHeader, judged: list[Judged]
) -> None:
    branches, _, _ = bench
    assert len(judged) == SHIFTS
    compared = 0
    for shift, branch in zip(judged, branches, strict=True):
        # The branch's own bus, repeated as it was, says what was really decided there.
        (*_, true) = as_it_was(branch, header)
        end_ms = shift.trajectory_parted_ms or shift.judged_to_ms
        assert end_ms is not None
        expected = [d for d in true.decisions if d.at_ms < end_ms]
        assert [d for d in shift.decisions if d.at_ms < end_ms] == expected
        assert shift.request_us == true.request_us
        compared += len(expected)
    assert compared > 20
    assert sum(shift.parted is not None for shift in judged) >= 2


def test_a_controller_that_would_ask_the_engine_is_said_to(
    bench: tuple[list[ClosedLoop], ClosedLoop, Path], header: RunHeader
) -> None:
    """It counts on more slip than is left once the brake has been released: it would not wait, but
    have the engine help, which has no model here."""
    _, loop, folder = bench
    aiming = header.settings.with_strategy(OTHER)
    window = replace(aiming.window, least_rad_s=30.0 * RPM)
    open_loop = OpenLoop(lambda header: replace(header, settings=replace(aiming, window=window)))
    header.save(folder)
    LogReplay(folder, verify=True, onlooker=open_loop).run(frames_of(loop))
    whys = [each.counterfactual.why for each in open_loop.judged.values() if each.counterfactual]
    assert any("asked the engine for speed" in why for why in whys), whys


def as_it_was(branch: ClosedLoop, header: RunHeader) -> list[Judged]:
    """The decisions on the branch's own bus, as they were sent."""
    trajectory, start_us, found = Trajectory(), 0, []
    sent: list[Frame] = []
    running = False
    for frame in frames_of(branch):
        if frame.can_id & 0xFF == OWN_ADDRESS:
            sent.append(frame)
        if frame.can_id != STATUS.spec.can_id:
            continue
        status = STATUS.decode(frame.data)
        step, sent = said(status.step_time_us, sent), []
        if not running and status.state in SHIFTING:
            trajectory, start_us, running = Trajectory(), status.step_time_us, True
        if running:
            trajectory.take(step)
        if step.outcome is not None:
            settings, running = header.settings, False
            found.append(
                judge(
                    step.outcome,
                    start_us,
                    trajectory,
                    trajectory,
                    None,
                    settings,
                    known=0,
                    strayed=None,
                )
            )
    return found


def test_the_recorded_strategy_itself_never_parts_and_decides_what_was_sent(
    bench: tuple[list[ClosedLoop], ClosedLoop, Path], header: RunHeader
) -> None:
    _, loop, folder = bench
    judged = judge_log(folder, header, frames_of(loop), RECORDED)
    assert len(judged) == SHIFTS
    for shift in judged:
        assert (shift.status, shift.parted, shift.trajectory_parted_ms) == ("fired", None, None)
        assert shift.last == shift.recorded
        assert shift.strategy == RECORDED
        assert shift.strayed_at_step is None


@pytest.mark.long
def test_a_follower_estimates_what_the_recorded_controller_estimated(
    bench: tuple[list[ClosedLoop], ClosedLoop, Path],
    header: RunHeader,
    judged: list[Judged],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With the recorded settings its decisions are those that were sent, and another strategy's are
    the same too, to the last digit."""
    _, loop, folder = bench
    plain = judged
    monkeypatch.setattr(open_loop_module, "estimates_differ", lambda _was, _now: True)
    for shift in judge_log(folder, header, frames_of(loop), RECORDED):
        assert (shift.status, shift.parted) == ("fired", None)
        assert shift.last == shift.recorded
    followed = judge_log(folder, header, frames_of(loop), OTHER)
    assert [shift.decisions for shift in followed] == [shift.decisions for shift in plain]
    for mine, its in zip(followed, plain, strict=True):
        assert mine.counterfactual is not None
        assert its.counterfactual is not None
        # the follower learns the sleeve's delay from the contact rounded to 1 us
        assert mine.counterfactual.phase_deg == pytest.approx(
            its.counterfactual.phase_deg, abs=1e-3
        )


def test_a_log_without_the_frames_of_a_step_judges_what_comes_before_it(
    bench: tuple[list[ClosedLoop], ClosedLoop, Path], header: RunHeader
) -> None:
    """And says that a shift was under way where the log could not be followed."""
    _, loop, folder = bench
    frames = frames_of(loop)
    steps = [i for i, frame in enumerate(frames) if frame.can_id == STATUS.spec.can_id]
    states = [STATUS.decode(frames[i].data).state.name for i in steps]
    cut = steps[len(states) - 1 - states[::-1].index("SYNCHRONISING")]
    header.save(folder)
    open_loop = OpenLoop(
        lambda header: replace(header, settings=header.settings.with_strategy(OTHER))
    )
    replay = LogReplay(folder, verify=False, onlooker=open_loop)
    (session,) = replay.run(frames[:cut] + frames[cut + 1 :])
    assert session.verdict is Verification.NOT_VERIFIABLE
    assert len(open_loop.judged) == SHIFTS - 1
    assert open_loop.unfinished == 1
