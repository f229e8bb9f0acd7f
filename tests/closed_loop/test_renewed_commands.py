"""What expires on the other side is renewed in time while it is meant, and ended when it is not."""

from __future__ import annotations

from itertools import pairwise

import pytest

from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import TSC1, ClutchCommand, Message, TscOverrideMode, ValveCommand
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SHEET = load_sheet("truck12")
EXPIRY_US = 100_000
"""docs/wire.md, valves, clutch and TSC1 alike."""
CYCLE_US = 10_000
COMMANDS = (TSC1, ValveCommand, ClutchCommand)


Run = list[tuple[int, Message]]


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    """What the controller sends in a shift up to the request after it, with times: one down, one
    up."""
    found = []
    for seed, pair in enumerate(((10, 8), (8, 10))):
        log: list[tuple[int, Frame]] = []
        drawn = draw(seed, SHEET, Preset.TRUCK, (pair,), 2, {}, Profile.TYPICAL)
        bench = ClosedLoop(SHEET, ControllerSettings(), Preset.TRUCK, drawn, log)
        assert bench.shift() is not None
        bench.prepare()
        ears = Receiver(*Node)
        heard = [(time_us, ears.receive(frame).message) for time_us, frame in log]
        found.append([(time_us, m) for time_us, m in heard if isinstance(m, COMMANDS)])
    return found


@pytest.mark.parametrize("kind", [ValveCommand, ClutchCommand])
def test_valves_and_clutch_are_commanded_several_times_before_they_would_expire(
    runs: list[Run], kind: type
) -> None:
    for run in runs:
        times_us = [time_us for time_us, message in run if isinstance(message, kind)]
        assert len(times_us) > 50
        longest_us = max(after - before for before, after in pairwise(times_us))
        assert longest_us <= 2 * CYCLE_US < EXPIRY_US


def test_an_engine_request_is_renewed_while_it_is_meant_and_ended_by_a_frame_of_its_own(
    runs: list[Run],
) -> None:
    for run in runs:
        requests = [(time_us, m) for time_us, m in run if isinstance(m, TSC1)]
        assert requests
        for (before_us, before), (after_us, _) in pairwise(requests):
            if before.override_control_mode is not TscOverrideMode.OVERRIDE_DISABLED:
                assert after_us - before_us <= 2 * CYCLE_US
        assert requests[-1][1].override_control_mode is TscOverrideMode.OVERRIDE_DISABLED
