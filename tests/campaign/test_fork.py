"""A copied bench goes on exactly as the original: strategies start from one and the same state."""

from __future__ import annotations

import pytest
from campaigns import small_spec

from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.spec import CampaignSpec
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.rig_sim.settings import Preset, Profile


def loop_of(spec: CampaignSpec, seed: int) -> ClosedLoop:
    drawn = draw(seed, spec.sheet, spec.preset, spec.pairs, spec.learn + 1, {}, Profile.CLEAN)
    return ClosedLoop(spec.sheet, spec.settings, spec.preset, drawn, log=[])


@pytest.mark.parametrize(
    "preset", [Preset.TRUCK, pytest.param(Preset.THESIS, marks=pytest.mark.long)]
)
def test_a_copy_and_its_original_go_on_as_if_never_copied(preset: Preset) -> None:
    spec = small_spec(preset, learn=1)
    loop, uncopied = loop_of(spec, 5), loop_of(spec, 5)
    loop.shift()
    copied = loop.fork()
    # The copy first, and differently: whatever it shared with the original would now show there.
    other = loop.fork()
    other.use(ControllerSettings(strategy_name="speed_window"), knows_all=True)
    for each in (other, copied, loop):
        assert each.shift() is not None
    uncopied.shift()
    uncopied.shift()
    assert copied.log == uncopied.log
    assert loop.log == uncopied.log
    assert other.log != uncopied.log


def test_a_switch_of_strategy_shows_in_the_run_hash() -> None:
    spec = small_spec(learn=0)
    loop, other = loop_of(spec, 3), loop_of(spec, 3)
    other.use(ControllerSettings(strategy_name="speed_window"), knows_all=False)
    loop.shift()
    other.shift()
    assert loop.log != other.log
