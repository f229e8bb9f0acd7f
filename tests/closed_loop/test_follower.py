"""A follower beside the controller whose trajectory it follows: with the same settings it estimates
the same, and a controller that goes on with its estimates says these."""

from __future__ import annotations

from typing import Any

from loop_bench import Loop, Tapped

from meshpoint.bus.core import Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ControllerStatus, ReferenceSource
from meshpoint.gearbox import MainGear
from meshpoint.replays.replay_estimator import ReplayEstimator


class Followed(Tapped):
    """A controller, and its follower with what each of them knew at each step."""

    def __init__(self, core: ControllerCore) -> None:
        super().__init__(core)
        self.follower = ReplayEstimator(core.header)
        self.knew: list[tuple[tuple[Any, ...], tuple[Any, ...]]] = []
        self.waiting: list[Frame] = []

    def receive(self, frame: Frame) -> None:
        super().receive(frame)
        self.waiting.append(frame)

    def step(self, now_us: int) -> Step:
        step = super().step(now_us)
        core: Any = self.core
        heard = sorted(self.waiting, key=lambda frame: frame.can_id)
        its = self.follower.step(heard, now_us, core.sequence, core.snapshot)
        self.waiting.clear()
        self.knew.append((reported(core.snapshot), reported(its)))
        return step


def reported(known: StepSnapshot) -> tuple[Any, ...]:
    """Everything in it that is estimated, by value."""
    state = known.layshaft.at(known.now_us)
    angles = None if state is None else (state.theta_rad, state.omega_rad_s)
    main = None if known.main is None else (known.main.theta_rad, known.main.omega_rad_s)
    speeds = known.speeds
    return (
        known.now_us, known.earliest_us, angles, main, speeds.layshaft, speeds.main,
        known.view.gear_number, known.lost, known.driven, known.supply_pa,
    )  # fmt: skip


def test_a_follower_by_the_same_settings_knows_what_the_controller_knows() -> None:
    """To the bit, through a shift and behind it; and gives its estimates to a controller that goes
    on by them."""
    loop = Loop([(300_000, 10)])
    core = loop.core
    followed = Followed(core)
    loop.nodes[0] = loop.controller = followed
    loop.run(1_600_000)
    assert any("shift 8 -> 10: engaged" in line for line in loop.events)
    assert len(followed.knew) > 100
    for mine, its in followed.knew:
        assert its == mine
    assert followed.knew[-1][0][2] is not None
    other = followed.follower
    assert core.observer is not other.observer
    other.hand_over(core)
    assert core.observer is other.observer
    loop.run(1_650_000)
    known = loop.last(ControllerStatus).reference_known
    assert not known & 2
    other.observer.references.adopt(MainGear.FIRST, 0.1, ReferenceSource.MEASURED)
    loop.run(1_700_000)
    assert loop.last(ControllerStatus).reference_known == known | 2
