"""Adapters in virtual time: what they do to frames, and which cannot carry ours."""

from __future__ import annotations

import pytest

from meshpoint.bench.adapter import AdapterCore, AdapterProfile
from meshpoint.bench.adapter_profiles import PROFILES, unfit
from meshpoint.bench.simulate import Setup, simulate
from meshpoint.bus.core import Step
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

SHEET = load_sheet("thesis")


class Ticking:
    """Steps each 10 ms of its clock and sends `count` frames then; notes what it gets and when."""

    def __init__(self, count: int = 1) -> None:
        self.count = count
        self.next_step_us = 0
        self.steps: list[int] = []
        self.heard: list[Frame] = []

    def receive(self, frame: Frame) -> None:
        self.heard.append(frame)

    def step(self, now_us: int) -> Step:
        self.steps.append(now_us)
        self.next_step_us = now_us + 10_000
        return Step([Frame(n, bytes(8)) for n in range(self.count)], [])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [])


def run(
    core: AdapterCore, until_us: int, arrivals: list[int] | None = None
) -> list[tuple[int, Frame]]:
    """Steps it whenever it is due, and hands frames over at these times."""
    now_us, sent, waiting = 0, [], sorted(arrivals or [])
    core.now_us = lambda: now_us
    while True:
        due_us = core.next_step_us
        if waiting and waiting[0] <= due_us:
            now_us = waiting.pop(0)
            core.receive(Frame(now_us & 0x7FF, bytes(8)))
            continue
        if due_us > until_us:
            return sent
        now_us = max(due_us, now_us)
        sent += [(now_us, frame) for frame in core.step(now_us).frames]


def test_frames_are_handed_over_in_bundles_and_in_order() -> None:
    inner = Ticking(0)
    core = AdapterCore(inner, AdapterProfile("x", bundle_us=1000, jitter_us=300), 1)
    arrivals = list(range(150, 9_000, 170))
    run(core, 12_000, arrivals)
    assert [f.can_id for f in inner.heard] == [t & 0x7FF for t in arrivals]
    assert 500 < core.in_us.quantile(0.5) < 900
    assert core.in_us.maximum <= 1300


def test_a_pause_holds_frames_back_and_loses_none() -> None:
    profile = AdapterProfile("x", stall_every_us=20_000, stall_us=8_000)
    inner = Ticking()
    core = AdapterCore(inner, profile, 2)
    sent = run(core, 500_000, list(range(500, 480_000, 1_000)))
    assert len(inner.heard) == 480
    assert 7_000 < core.in_us.maximum <= 8_001
    assert len(sent) in (len(inner.steps), len(inner.steps) - 1)


def test_a_full_queue_swallows_frames_and_counts_them() -> None:
    profile = AdapterProfile("x", delay_us=500, queue_frames=10)
    core = AdapterCore(Ticking(12), profile, 1)
    sent = run(core, 9_000)
    assert len(sent) == 10
    assert core.dropped == 2
    assert {at for at, _ in sent} == {500}


def test_throughput_spreads_frames_out() -> None:
    profile = AdapterProfile("x", bytes_per_s=10_000, overhead_bytes=2, bytes_per_data_byte=1)
    sent = run(AdapterCore(Ticking(3), profile, 1), 9_000)
    assert [at for at, _ in sent] == [1_000, 2_000, 3_000]


@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_a_drifting_clock_is_the_nodes_own(ppm: float) -> None:
    inner = Ticking()
    core = AdapterCore(inner, AdapterProfile("x", clock_ppm=ppm), 1)
    at = [time_us for time_us, _ in run(core, 10_000_000)]
    assert inner.steps[:3] == [0, 10_000, 20_000] or ppm > 0
    assert at[-1] - at[0] == pytest.approx((len(at) - 1) * 10_000 * (1 - ppm * 1e-6), abs=15)


def test_an_ideal_adapter_changes_nothing() -> None:
    def rows(adapter: AdapterProfile | None):
        settings = ControllerSettings()
        setup = Setup(SHEET, settings, Preset.THESIS, seed=3, shifts=1, adapter=adapter)
        return simulate(setup).rows

    assert rows(PROFILES["ideal"]) == rows(None)


def test_which_adapters_cannot_carry_our_messages_is_known_before(capsys) -> None:
    refused = {name for name, profile in PROFILES.items() if unfit(profile)}
    assert refused == {"slcan", "socketcand"}
    for name in refused:
        assert main(["simulate", "--adapter", name, "--shifts", "1"]) == 2
        assert f"--adapter {name} cannot work" in capsys.readouterr().err


def test_every_profile_says_where_its_figures_are_from() -> None:
    for profile in PROFILES.values():
        assert len(profile.source) > 20
        if profile.stall_us:
            assert "assumed" in profile.source
