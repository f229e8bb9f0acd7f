"""The main shaft's tracker by hand: what each beginning and each end leaves of its state, and whom
it tells of which edges."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation import main_tracker as module
from meshpoint.controller.estimation.lash import Lash, LashStart
from meshpoint.controller.estimation.lash_rivals import AHEAD_US, Prediction
from meshpoint.controller.estimation.main_tracker import Behind, MainTracker
from meshpoint.controller.estimation.tooth_match import PatternEquations
from meshpoint.controller.motion.swing import Swing
from meshpoint.controller.records import Vector
from meshpoint.controller.sensing.wheel_edges import NO_EDGES, EdgeBatch
from meshpoint.controller.settings import CrossingFilterTuning
from meshpoint.gearbox import Range
from meshpoint.gearbox.driveline import Axle

TUNING = CrossingFilterTuning()
TEETH, RAD_S = 45, 60.0
HALF_PITCH = math.pi / TEETH
RATIOS = (0.25, 1.0)
GAP_RAD = math.radians(0.7)


def batch(first: int, last: int) -> EdgeBatch:
    """Edges of a shaft at an even speed."""
    number = np.arange(first, last)
    angle: Vector = HALF_PITCH * number.astype(np.float64)
    return EdgeBatch(angle / RAD_S * 1e6, angle, number // 2 % TEETH, number % 2)


def turn(tracker: MainTracker, first: int, last: int) -> None:
    for number in range(first, last, 6):
        tracker.edges(batch(number, number + 6))


def noting(log: list[Any], answer: Any = None) -> Any:
    """Something that keeps what it is given, and always gives the same answer."""

    def take(*given: Any) -> Any:
        log.append(given)
        return answer

    return take


def a_tracker(edges: int = 60) -> Any:
    tracker = MainTracker(TUNING, TEETH, range_ratios=RATIOS, behind=Behind(Axle(), GAP_RAD))
    turn(tracker, 0, edges)
    return tracker


def free(edges: int = 60, range_: Range = Range.LOW) -> Any:
    """In neutral, before the first edges there."""
    tracker = a_tracker(edges)
    tracker.set_free(True, range_, [])
    return tracker


def test_a_shaft_behind_which_nothing_is_said_to_turn_has_a_sheet_s_axle_and_a_degree() -> None:
    """Driven by something unknown it is accelerated by white noise of density 2 a^2 tau, and its
    steady acceleration wanders; neither mode swings."""
    plain: Any = MainTracker(TUNING, TEETH)
    assert plain._half_gap_rad == math.radians(1.0)
    told = a_tracker(0)
    assert told._half_gap_rad == GAP_RAD
    for tracker, ratios in ((plain, (1.0, 1.0)), (told, RATIOS)):
        for step, ratio in zip((Range.LOW, Range.HIGH), ratios, strict=True):
            lash = tracker._lashes[step]
            assert (lash.axle, lash.ratio) == (Axle(), ratio)
            assert lash.prior == Lash(Axle(), TUNING.lash_rad, TUNING.lash_factor, ratio).prior
    white = 2.0 * TUNING.follow_rad_s2**2 * TUNING.follow_s
    still = [1.0, 0.5, 0.0]
    assert told._following.flat.tolist() == pytest.approx(
        [white, TUNING.main_walk_rad_s2**2, *still, *still]
    )
    known = told.edge_time
    assert known.value == pytest.approx(TUNING.edge_time_s)
    assert (known.sd, known.least_sd) == pytest.approx((math.log(2.0), 0.03))
    assert [math.exp(known.least_log), math.exp(known.most_log)] == pytest.approx([1e-6, 2e-4])
    assert (told._range, told._free, told._cloud, told._course) == (
        Range.HIGH, False, None, (0.0, None))  # fmt: skip
    assert told._motion is told._following


def test_a_gear_that_comes_out_leaves_angle_and_speed_in_doubt_and_all_begins_there() -> None:
    """Half a pitch and a tenth of the speed, with the blow of a flank. All that gathers edges of a
    window in neutral begins with that state."""
    tracker = a_tracker()
    x = tracker._filter.x.copy()
    now_us = tracker._filter.time_us
    tracker._filter.heed(0.3)
    tracker._run.add(np.array([1.0]), np.array([0.1]), np.array([5]))
    tracker._rivals[Range.LOW]._window = 3.0
    tracker._in_gear._count = 4
    tracker.set_free(True, Range.LOW, [])
    state = tracker._filter
    assert state.x[:2].tolist() == x[:2].tolist()
    assert not state.x[2:].any()
    assert state.p[0, 0] == pytest.approx(HALF_PITCH**2)
    assert state.p[1, 1] == pytest.approx((0.1 * x[1]) ** 2 + 5.0**2)
    assert state.p[0, 1] == state.p[1, 0] == 0.0
    wanted_x, wanted_p = x.copy(), state.p.copy()
    tracker._swings[Range.LOW].start(wanted_x, wanted_p)
    assert state.p == pytest.approx(wanted_p)
    began_us, began_x, began_p = tracker._began
    assert began_us == state.time_us == now_us
    assert began_x.tolist() == state.x.tolist()
    assert began_p.tolist() == state.p.tolist()
    assert tracker.teeth.learner.running
    assert tracker.teeth.learner._memory.time_us[0] == now_us
    assert tracker.teeth.learner._memory.p.tolist() == state.p.tolist()
    assert state._memory.part("heed")[0] == 0.0
    assert state._memory.held[0] == 0
    assert tracker._run.edges.shape == (2, 0)
    assert tracker._rivals[Range.LOW]._window == 0.0
    assert tracker._in_gear._count == 0
    assert (tracker._range, tracker._free) == (Range.LOW, True)
    assert tracker._motion is tracker._swings[Range.LOW].motion


@pytest.mark.parametrize("lack", ["free", "running", "range", "already"])
def test_a_window_in_neutral_begins_once_and_with_a_speed_and_a_range(lack: str) -> None:
    tracker = a_tracker()
    begun: list[Range] = []
    tracker._begin_free = begun.append
    tracker._running = lack != "running"
    tracker._free = lack == "already"
    tracker.set_free(lack != "free", None if lack == "range" else Range.LOW, [])
    assert not begun
    tracker._running, tracker._free = True, False
    tracker.set_free(True, Range.HIGH, [])
    assert begun == [Range.HIGH]


@pytest.mark.parametrize(("later_us", "told"), [(-5e3, 0.0), (5e3, 5e3)])
def test_a_gear_came_out_no_earlier_than_the_newest_edge(later_us: float, told: float) -> None:
    """What was seen of the driveline in gear is asked for then."""
    tracker = a_tracker()
    seen: list[Any] = []
    asked: list[Any] = []
    now_us = tracker._filter.time_us
    tracker._before.released = noting(seen)
    loaded = SimpleNamespace(behind=noting(asked, "behind"))
    tracker.set_free(True, Range.LOW, [], now_us + later_us, -70.0, loaded)
    assert seen == [(now_us + told, -70.0, "behind")]
    assert asked == [(now_us + told,)]
    tracker = a_tracker()
    tracker._before.released = noting(seen)
    tracker.set_free(True, Range.LOW, [])
    assert seen[1] == (now_us, 0.0, None)


def test_a_gear_that_comes_in_again_leaves_angle_and_speed_and_its_blow() -> None:
    """Half a pitch and 5 rad/s more; of the acceleration what a start allows. What was learned is
    said, and noise follows what is seen again."""
    tracker = free()
    turn(tracker, 60, 90)
    state, events = tracker._filter, ["before"]
    order: list[Any] = []
    before = state.p[:2, :2].copy()
    for name in ("_end_lash", "_learn_swing", "_learn_teeth"):
        setattr(tracker, name, noting(order))
    tracker.set_free(False, None, events)
    assert order == [(), (), ("main shaft", events)]
    blow = np.diag((HALF_PITCH**2, 5.0**2))
    assert state.p[:2, :2] == pytest.approx(before + blow)
    rest = state.p.copy()
    rest[:2, :2] = 0.0
    assert np.count_nonzero(rest) == 1
    assert rest[2, 2] == pytest.approx(TUNING.main_start_rad_s2**2)
    assert not state.x[2:].any()
    assert state._memory.part("heed")[0] == 0.1
    assert state._memory.held[0] == 0
    assert not tracker._free
    tracker.set_free(False, None, events)
    assert len(order) == 3, "it ends once"


class Cloud:
    """A cloud of drivelines that is asked and told."""

    def __init__(self, *given: Any) -> None:
        self.given = given
        self.taken: list[Any] = []
        self.time_us, self.is_alive = 40e3, True
        self.next: Any = None

    def take(self, edges: Vector, tooth_rad: float) -> None:
        self.taken.append((edges, tooth_rad))

    def course(self, half_gap_rad: float) -> Any:
        assert half_gap_rad == GAP_RAD
        return self.next

    log_figure, vehicle = "as it was told", "as it goes"


class Course:
    """One that goes ahead by a rule."""

    speed_sd_rad_s, hill_rad_s2 = 0.25, -1.5

    def __init__(self, wait_s: float = 0.0) -> None:
        self.wait_s = wait_s

    def ahead(self, wait_s: float) -> tuple[float, float]:
        return 3.0 + 10.0 * (self.wait_s + wait_s), 60.0 + self.wait_s + wait_s

    def theta_sd_ahead(self, wait_s: float) -> float:
        return 0.5 + self.wait_s + wait_s

    def after(self, wait_s: float) -> Course:
        return Course(self.wait_s + wait_s)


class Rivals:
    """Both models' rivalry, as it is set."""

    def __init__(self) -> None:
        self.tries_lash, self.believes_lash, self.asks = True, False, False
        self.judged: list[Any] = []
        self.told: list[Any] = []
        self.asked: list[float] = []
        self.ended = 0

    def judge(self, edges: Vector, within_rad: float) -> None:
        self.judged.append((edges, within_rad))

    def wants(self, from_us: float) -> bool:
        self.asked.append(from_us)
        return self.asks

    def predict(self, *given: Any) -> None:
        self.told.append(given)

    def end(self) -> None:
        self.ended += 1

    def begin(self) -> None:
        """A window begins."""


def rivalry(**values: bool) -> tuple[Any, Rivals]:
    """A shaft in neutral in the low range, with a cloud."""
    tracker, rivals = free(), Rivals()
    for name, value in values.items():
        setattr(rivals, name, value)
    tracker._rivals[Range.LOW] = rivals
    tracker._cloud = Cloud()
    return tracker, rivals


EDGES = np.array([[1.0, 2.0], [0.1, 0.2]])


def test_edges_in_gear_tell_where_the_vehicle_is_and_those_in_neutral_the_cloud() -> None:
    tracker = a_tracker(0)
    seen: list[Any] = []
    gathered: list[Any] = []
    tracker._before.take_in_gear = seen.append
    tracker._in_gear.edges = gathered.append
    turn(tracker, 0, 12)
    counted = len(seen)
    tracker._running = False
    tracker._seed.restart()
    tracker.edges(batch(12, 13))
    assert len(seen) == counted, "it has no speed yet"
    turn(tracker, 12, 30)
    assert len(gathered) == 6
    assert len(seen) > counted
    counted = len(seen)
    assert seen[-1].tolist() == [batch(24, 30).time_us.tolist(), batch(24, 30).theta_rad.tolist()]
    tracker.edges(NO_EDGES)
    assert len(seen) == counted
    tracker.set_free(True, Range.LOW, [])
    gathered.clear()
    cloud, rivals = Cloud(), Rivals()
    tracker._cloud, tracker._rivals[Range.LOW] = cloud, rivals
    turn(tracker, 30, 36)
    assert len(seen) == counted and not gathered
    ((edges, tooth_rad),) = cloud.taken
    assert edges is rivals.judged[0][0] is tracker.placed
    assert edges.tolist() == [batch(30, 36).time_us.tolist(), batch(30, 36).theta_rad.tolist()]
    assert tooth_rad == tracker.teeth.sd_rad
    assert rivals.judged[0][1] == GAP_RAD
    assert rivals.asked == [tracker._filter.time_us]


def test_edges_are_kept_for_the_window_s_end_while_teeth_are_learned() -> None:
    tracker = a_tracker(30)
    assert tracker._run.edges.shape == (2, 0)
    tracker.set_free(True, Range.LOW, [])
    turn(tracker, 30, 42)
    tracker.edges(NO_EDGES)
    assert len(tracker._run._edges) == 2
    assert tracker._run.edges[1] == pytest.approx(HALF_PITCH * np.arange(30, 42))
    assert tracker._run.places.tolist() == list(range(30, 42))
    tracker.teeth.learner.running = False
    turn(tracker, 42, 48)
    assert len(tracker._run._edges) == 2


@pytest.mark.parametrize("enough", [False, True])
def test_a_cloud_begins_with_the_first_edges_in_neutral_once_they_are_enough(
    enough: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It then takes all that have waited. The range's own lash, and an edge's time as known."""
    tracker, rivals = rivalry()
    monkeypatch.setattr(module, "LashCloud", Cloud)
    start = LashStart(1.0, 2.0, 3.0, 4.0)
    asked: list[Any] = []
    waiting = np.array([[5.0, 6.0, 7.0], [0.5, 0.6, 0.7]])
    before = SimpleNamespace(take_out=noting(asked, start if enough else None), waiting=waiting)
    tracker._before, tracker._cloud = before, None
    tracker._follow_lash(EDGES)
    lash = tracker._lashes[Range.LOW]
    assert asked == [(EDGES, lash.vehicle_sds)]
    assert (tracker._cloud is not None) is enough
    assert len(rivals.judged) == int(enough)
    if enough:
        assert tracker._cloud.given == (lash, start, tracker.edge_time.value)
        assert tracker._cloud.taken[0][0] is waiting
        assert rivals.judged[0][0] is waiting
        tracker._follow_lash(EDGES)
        assert len(asked) == 1
        assert tracker._cloud.taken[1][0] is EDGES


def test_no_cloud_is_followed_where_a_range_shows_no_backlash() -> None:
    tracker, rivals = rivalry(tries_lash=False)
    tracker._follow_lash(EDGES)
    assert not tracker._cloud.taken and not rivals.judged
    assert tracker.shafts(Range.LOW) is None
    assert tracker.shafts(Range.HIGH) == tracker._lashes[Range.HIGH].shafts


@pytest.mark.parametrize("asks", [False, True])
@pytest.mark.parametrize("believes", [False, True])
@pytest.mark.parametrize("lost", [False, True])
def test_both_models_say_what_comes_next_when_they_are_asked(
    asks: bool, believes: bool, lost: bool
) -> None:
    """From the newest edge on: the cloud's course begins with its own newest. While backlash is
    believed its course is the shaft's at each step."""
    tracker, rivals = rivalry(asks=asks, believes_lash=believes)
    tracker._cloud.next = None if lost else Course()
    now_us = tracker._filter.time_us
    tracker._cloud.time_us = now_us - 3e3
    tracker._follow_lash(EDGES)
    told = asks or believes
    assert tracker._course == ((now_us - 3e3, tracker._cloud.next) if told else (0.0, None))
    assert len(rivals.told) == int(asks and not lost)
    if rivals.told:
        ((from_us, swing, lash),) = rivals.told
        assert from_us == now_us
        wait_s = AHEAD_US * 1e-6
        assert tuple(lash) == pytest.approx((3.0 + 10.0 * (wait_s + 3e-3), 0.503 + wait_s))
        motion = tracker._swings[Range.LOW].motion
        linear = Swing(tracker._filter.x, tracker._filter.p, motion)
        expected = linear.ahead(wait_s)[0], linear.theta_sd_ahead(wait_s)
        assert tuple(swing) == pytest.approx(expected)
        assert isinstance(lash, Prediction)


@pytest.mark.parametrize("lack", ["none", "cloud", "alive", "belief"])
def test_a_window_s_cloud_is_learned_from_where_it_lives_and_backlash_is_believed(
    lack: str,
) -> None:
    """And tells the next window how fast the vehicle is."""
    tracker, rivals = rivalry(believes_lash=lack != "belief")
    cloud = tracker._cloud
    learned: list[Any] = []
    vehicles: list[Any] = []
    cloud.is_alive = lack != "alive"
    tracker._cloud = None if lack == "cloud" else cloud
    tracker._course = (5.0, Course())
    tracker._lashes[Range.LOW].learn = learned.append
    tracker._before.take_vehicle = noting(vehicles)
    tracker._end_lash()
    assert rivals.ended == 1
    assert (tracker._cloud, tracker._course) == (None, (0.0, None))
    assert learned == ([cloud.log_figure] if lack == "none" else [])
    assert vehicles == ([("as it goes",)] if lack == "none" else [])


@pytest.mark.parametrize("learned", [False, True])
@pytest.mark.parametrize("running", [False, True])
def test_at_a_window_s_end_its_swing_is_learned_and_its_teeth_by_that_swing(
    learned: bool, running: bool
) -> None:
    """With the teeth's errors taken out as far as they are known; the equations of teeth stand on
    nominal angles, and on what is known of the window's start as it was."""
    tracker = free()
    turn(tracker, 60, 72)
    windows: list[Any] = []
    swing, known = tracker._swings[Range.LOW], tracker.edge_time
    surer = known.__class__(math.log(2e-5), *[0.1] * 5)
    swing.learn = noting(windows, surer)
    teeth = tracker.teeth
    teeth.error_rad = 1e-3 * np.arange(90.0)
    teeth.learned, teeth.learner.running = learned, running
    begun: list[Any] = []
    teeth.learner.begin = noting(begun)
    teeth.learner.take_all = noting(begun)
    start_p = tracker._began[2].copy()
    tracker._learn_swing()
    ((window, given, teeth_known),) = windows
    angles = HALF_PITCH * np.arange(60, 72)
    places = np.arange(60, 72) % 90
    assert window.edges[0] == pytest.approx(angles / RAD_S * 1e6)
    assert window.edges[1] == pytest.approx(angles + (1e-3 * places if learned else 0.0))
    assert (window.time_us, window.tooth_rad) == (tracker._began[0], teeth.sd_rad)
    assert window.x is tracker._began[1] and window.p is tracker._began[2]
    assert (given, teeth_known) == (known, learned)
    assert tracker.edge_time is surer
    assert tracker._filter._memory.part("edge_time_s")[0] == pytest.approx(2e-5)
    assert bool(begun) is running
    if running:
        (from_us, x, p), (edges, where, model) = begun
        assert (from_us, x.tolist()) == (tracker._began[0], tracker._began[1].tolist())
        swing.start(x.copy(), start_p)
        assert p == pytest.approx(start_p)
        assert edges[1] == pytest.approx(angles)
        assert where.tolist() == places.tolist()
        assert model is swing.motion
        assert teeth.learner._memory.part("edge_time_s")[0] == pytest.approx(2e-5)


def test_teeth_are_learned_by_any_motion_where_the_driveline_rattles() -> None:
    tracker, rivals = rivalry()
    model = tracker._motion
    assert tracker._teeth_motion(model) is model
    rivals.believes_lash = True
    assert tracker._teeth_motion(model) is tracker._following
    assert tracker._has_lash


def test_a_shaft_s_state_goes_on_by_its_swing_from_the_newest_edge() -> None:
    tracker = free()
    turn(tracker, 60, 90)
    state, motion = tracker._filter, tracker._swings[Range.LOW].motion
    newest = Swing(state.x, state.p, motion)
    found = tracker.at(state.time_us + 8e3)
    x, p = newest.spread_ahead(8e-3)
    assert found is not None
    assert (found.time_us, found.swing.model) == (state.time_us + 8e3, motion)
    numbers = found.theta_rad, found.omega_rad_s, found.acceleration_rad_s2
    assert numbers == pytest.approx((x[0], x[1], x[2]))
    sds = found.theta_sd_rad, found.omega_sd_rad_s
    assert sds == pytest.approx((math.sqrt(p[0, 0]), math.sqrt(p[1, 1])))
    assert found.swing.x == pytest.approx(x)
    assert found.swing.p == pytest.approx(p)
    omega = state.x[1]
    edge = (omega * tracker.edge_time.value) ** 2 + TUNING.tooth_error_rad**2
    assert found.swing.edge_rad2_s == pytest.approx(edge * HALF_PITCH / omega)
    assert tracker.at(state.time_us + 61e3) is None
    for i in (0, 1):
        state.p[i, :] = state.p[:, i] = 0.0
        state.p[i, i] = -1e-12
    assert tracker.at(state.time_us).theta_sd_rad == 0.0


@pytest.mark.parametrize("believes", [False, True])
def test_a_shaft_s_state_is_its_cloud_s_where_backlash_is_believed(believes: bool) -> None:
    """From the cloud's newest edge on: here it went 10 rad/s."""
    tracker, _ = rivalry(believes_lash=believes)
    now_us = tracker._filter.time_us
    tracker._course = (now_us - 2e3, Course())
    found = tracker.at(now_us + 5e3)
    assert bool(found.acceleration_rad_s2 == -1.5) is believes
    if believes:
        assert isinstance(found.swing, Course)
        assert found.swing.wait_s == pytest.approx(7e-3)
        assert found[1:5] == pytest.approx((3.07, 60.007, 0.507, 0.25))
        assert found.time_us == now_us + 5e3
        tracker._course = (0.0, None)
        assert isinstance(tracker.at(now_us).swing, Swing)


def test_a_speed_that_is_lost_takes_cloud_and_freedom_with_it() -> None:
    tracker, _ = rivalry()
    lost: list[bool] = []
    tracker._before.lose = lambda: lost.append(True)
    tracker._course = (5.0, Course())
    tracker.lose_speed()
    assert (tracker._cloud, tracker._course) == (None, (0.0, None))
    assert (tracker._free, tracker._running, lost) == (False, False, [True])
    assert not tracker.teeth.learner.running


def test_what_an_earlier_run_learned_is_taken_up_in_the_range_it_is_of() -> None:
    """An edge's time goes to the filter at once."""
    tracker, other = a_tracker(0), a_tracker(0)
    tracker.take_edge_time(3e-5, 0.2)
    assert (tracker.edge_time.value, tracker.edge_time.sd) == pytest.approx((3e-5, 0.2))
    assert tracker._filter._memory.part("edge_time_s")[0] == pytest.approx(3e-5)
    assert tracker.record(Range.LOW) is None
    swing, lash = tracker._swings[Range.LOW], tracker._lashes[Range.LOW]
    swing.shifts = 4
    lash.restore(0.05, 0.3)
    tracker._rivals[Range.LOW].restore(True)
    record = tracker.record(Range.LOW)
    assert record is not None
    assert record.half_lash_rad == pytest.approx(0.05)
    assert record.has_lash is True
    other.restore(Range.LOW, record)
    assert other._swings[Range.LOW].shifts == 4
    assert other._lashes[Range.LOW].known == pytest.approx(lash.known)
    assert other._rivals[Range.LOW].believes_lash
    assert other.record(Range.HIGH) is None
    assert not other._rivals[Range.HIGH].believes_lash


def test_what_a_window_shows_of_teeth_is_said_and_a_window_of_none_says_nothing() -> None:
    tracker = free()
    turn(tracker, 60, 72)
    events: list[str] = []
    tracker.teeth.learner.end = lambda: PatternEquations(
        np.eye(90) * 1e10, np.zeros(90), 30.0, 90.0
    )
    tracker.set_free(False, None, events)
    assert events == ["main shaft teeth learned to 0.003 deg"]
