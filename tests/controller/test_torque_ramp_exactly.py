"""The engine's torque is taken away before the clutch sets off: what is asked for at each step,
when it may set off, and how a step of a ramp is put off, by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.shift import torque_ramp
from meshpoint.controller.shift.driveline_look import DrivelineLook
from meshpoint.controller.shift.swing_fit import Known, SwingFit
from meshpoint.controller.shift.torque_ramp import ramp_down
from meshpoint.controller.shift.unloading import GearedBodies, Loaded, Unloading, geared_bodies
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET = load_sheet("truck12")
ENGINE, CLUTCH = SHEET.engine, SHEET.clutch
SETTINGS = ControllerSettings()
LIMITS = SETTINGS.engine
NOW_US, MS, TICK_US = 5_000_000, 1_000, 10_000
KNOWN = Known(16_000.0, 0.1, 1.0 / 900.0, 1e-4)
BODIES = geared_bodies(SHEET, DRIVE_GEARS[7], KNOWN)
HALF_US = BODIES.half_period_us
STEP = 0.01
KISS = 0.4
PARTING_S = CLUTCH.open_delay_s * (1.0 - KISS)
OWN_NM, LEFT_NM = 0.5 * ENGINE.reference_nm, 0.1 * ENGINE.reference_nm


class Driveline:
    """What is seen of one that twists: laid down; what it is told is noted."""

    def __init__(self) -> None:
        self.twists, self.torque_step, self.engine_rad_s2 = True, STEP, 0.0
        self.known, self.learned = KNOWN, KNOWN
        self.share: float | None = 0.5
        self.fitted: tuple[SwingFit, float] | None = (SwingFit(KNOWN, -0.2), OWN_NM)
        self.asked, self.loads = list[float](), 0
        self.fits: list[tuple[GearedBodies, float]] = []
        self.periods, self.pressed = list[float](), list[tuple[float, ...]]()

    def loaded(self) -> None:
        self.loads += 1

    def mean_share(self, period_us: float) -> float | None:
        self.periods.append(period_us)
        return self.share

    def fit(self, bodies: GearedBodies, since_us: float) -> tuple[SwingFit, float] | None:
        self.fits.append((bodies, since_us))
        return self.fitted

    def torque_sd_nm(self, engine_rad_s2: float) -> float:
        return DrivelineLook(SHEET).torque_sd_nm(engine_rad_s2)

    def press(self, *given: float) -> None:
        self.pressed.append(given)

    def ask(self, share: float) -> None:
        self.asked.append(share)


class Step:
    """One step of a clutch that is to open."""

    def __init__(self, settings: ControllerSettings = SETTINGS) -> None:
        self.seen, self.left = Driveline(), 0.3
        self.told: list[float] = []
        self.shift = SimpleNamespace(unloading=None, from_number=7, owed_share=0.0)
        torque = SimpleNamespace(left_in=self._left_in, share=0.5)
        self.context: Any = SimpleNamespace(
            settings=settings, sheet=SHEET, engine_carries=lambda _: True, torque=torque,
            kiss=SimpleNamespace(share=KISS), running=self.shift, driveline=self.seen,
            clutch_opens=False, since_us=NOW_US - 20 * MS, engine_share=None, tick_us=TICK_US,
        )  # fmt: skip
        self.snapshot: Any = SimpleNamespace(
            now_us=NOW_US, speeds=SimpleNamespace(layshaft=150.0),
            layshaft=SimpleNamespace(drag_nm=lambda omega: 0.04 * omega),
        )  # fmt: skip

    def _left_in(self, ahead_s: float) -> float | None:
        self.told.append(ahead_s)
        return self.left

    def ramp(self, taken: int = 1, step_us: float = NOW_US - 10 * MS, **changed: Any) -> Step:
        made = Unloading(BODIES, OWN_NM, LEFT_NM, (0.25, 0.5, 0.25), 50_000.0, taken,
                         NOW_US - 900 * MS, step_us)  # fmt: skip
        self.shift.unloading = made._replace(**changed)
        return self

    def run(self) -> bool:
        return ramp_down(self.context, self.snapshot)

    @property
    def unloading(self) -> Unloading:
        made = self.shift.unloading
        assert isinstance(made, Unloading)
        return made


def rigid(left: float | None = 0.3) -> Step:
    step = Step()
    step.seen.twists = False
    step.left = left  # type: ignore[assignment]
    return step


def test_the_torque_left_is_that_at_the_plates_parting() -> None:
    step = rigid()
    assert step.run() is False
    assert step.told == [pytest.approx(PARTING_S)]
    assert step.context.engine_share == 0.0


def test_an_engine_that_does_not_say_its_torque_is_not_waited_for() -> None:
    step = rigid(None)
    assert step.run() is True
    assert step.context.engine_share is None


@pytest.mark.parametrize(("waited_us", "may"), [(-1, False), (0, True)])
def test_a_rigid_driveline_waits_no_longer_than_the_settings_say(waited_us: int, may: bool) -> None:
    step = rigid(0.4)
    step.context.since_us = NOW_US - LIMITS.ramp_ms * MS - waited_us
    assert step.run() is may


@pytest.mark.parametrize("reason", ["rigid", "no gear", "no ramp", "unseen", "no fit", "opens"])
def test_where_nothing_can_be_unloaded_the_torque_is_taken_away_at_once(reason: str) -> None:
    settings = SETTINGS
    if reason == "no ramp":
        settings = replace(SETTINGS, engine=replace(LIMITS, swing_ramp_ms=0))
    step = Step(settings)
    step.seen.twists = reason != "rigid"
    step.shift.from_number = 0 if reason == "no gear" else 7
    step.context.clutch_opens = reason == "opens"
    if reason == "unseen":
        step.seen.share = None
    if reason == "no fit":
        step.seen.fitted = None
    assert step.run() is False
    assert step.shift.unloading is None
    assert step.context.engine_share == 0.0
    assert step.seen.loads == (reason in ("unseen", "no fit"))


def begun(step: Step, monkeypatch: pytest.MonkeyPatch, *overs_us: float) -> list[Any]:
    """A ramp begins, of those that are laid down by when they are over."""
    asked = list[Any]()

    def unloading(*given: Any) -> list[Unloading]:
        asked.append(given)
        return [
            Unloading(given[1], OWN_NM, LEFT_NM, (1.0,), over_us, 1, NOW_US, NOW_US)
            for over_us in overs_us
        ]

    monkeypatch.setattr(torque_ramp, "unloading", unloading)
    step.run()
    return asked


MOST_US = LIMITS.swing_ramp_ms * MS


@pytest.mark.parametrize(
    ("overs", "chosen"),
    [((MOST_US,), MOST_US), ((9e6, 1e7), 9e6), ((3e5, 6e5, 9e6), 6e5), ((3e5, MOST_US), MOST_US),
     ((3e5, MOST_US + 1.0), 3e5)],
)  # fmt: skip
def test_of_the_ramps_that_are_over_in_time_the_calmest_is_taken(
    overs: tuple[float, ...], chosen: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the shortest of all."""
    step = Step()
    begun(step, monkeypatch, *overs)
    assert step.unloading.settle_us == chosen
    assert step.context.engine_share == pytest.approx(0.1), "asked for at once"


@pytest.mark.parametrize("layshaft", [150.0, None])
def test_a_ramp_begins_from_what_engine_and_shafts_carry_without_their_swing(
    layshaft: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine's mean torque of a period; the shafts' and the vehicle's by what has been seen in
    one period, or in 0.4 s."""
    step, acceleration, torque_nm = Step(), -0.2, 0.45 * ENGINE.reference_nm
    step.snapshot.speeds.layshaft = layshaft
    step.seen.fitted = (SwingFit(KNOWN, acceleration), torque_nm)
    ((sheet, bodies, loaded, now_us),) = begun(step, monkeypatch, 1e5)
    drag_nm = 0.0 if layshaft is None else 6.0
    assert (sheet, now_us) == (SHEET, NOW_US)
    assert bodies == geared_bodies(SHEET, DRIVE_GEARS[7], KNOWN, drag_nm)
    pulled = bodies.ratio * torque_nm - bodies.engine_kgm2 * acceleration - bodies.drag_nm
    doubt = DrivelineLook(SHEET).torque_sd_nm(bodies.ratio * acceleration)
    expected = Loaded(0.5 * ENGINE.reference_nm, pulled, acceleration - pulled / 900.0, doubt)
    assert loaded == pytest.approx(expected)
    (pressed,) = step.seen.pressed
    assert pressed == pytest.approx((pulled, bodies.ratio * doubt, bodies.harmless_nm))
    assert step.seen.periods == [pytest.approx(2.0 * bodies.half_period_us)]
    ((_, since_us),) = step.seen.fits
    assert since_us == pytest.approx(NOW_US - max(2.0 * bodies.half_period_us, 400 * MS))
    assert step.seen.loads == 1


@pytest.mark.parametrize("number", [1, 12])
def test_a_slow_swing_is_looked_at_for_its_period_and_a_fast_one_for_400_ms(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Step()
    step.shift.from_number = number
    ((_, bodies, _, _),) = begun(step, monkeypatch, 1e5)
    period_us = 2.0 * bodies.half_period_us
    assert (period_us > 400 * MS) is (number == 1)
    ((_, since_us),) = step.seen.fits
    assert since_us == pytest.approx(NOW_US - max(period_us, 400 * MS))


def asked_share(taken: int) -> float:
    return 0.5 - 0.4 * (0.25, 0.75, 1.0)[taken - 1]


@pytest.mark.parametrize(("taken", "owed", "told", "left"), [
    (1, 0.0, 0.40, 0.0), (2, 0.0, 0.20, 0.0), (2, 0.004, 0.20, 0.004), (2, 0.006, 0.21, -0.004),
    (2, -0.007, 0.19, 0.003),
])  # fmt: skip
def test_what_rounding_leaves_out_is_asked_for_with_the_next_frame(
    taken: int, owed: float, told: float, left: float
) -> None:
    """A ramp under way goes on; in steps of a per cent."""
    step = Step().ramp(taken)
    step.shift.owed_share = owed
    assert step.run() is False
    assert step.context.engine_share == pytest.approx(told)
    assert step.shift.owed_share == pytest.approx(left, abs=1e-9)
    assert step.seen.asked == [pytest.approx(asked_share(taken))]
    assert step.seen.loads == 0


@pytest.mark.parametrize(
    ("own", "accelerates", "wanted", "given"),
    [(0.3, 0.0, 0.4, 0.305), (0.3, 0.0, 0.2, 0.2), (0.3, 0.0, -0.1, -0.005),
     (-0.2, 0.0, -0.3, -0.205), (-0.2, 0.0, 0.1, 0.005), (-0.2, 0.0, -0.1, -0.1),
     (0.0, -0.1, -0.08, -0.08), (0.0, -0.1, -0.2, -0.105), (0.0, 0.1, 0.2, 0.105),
     (None, 0.0, 0.1, 0.005), (0.3, 0.1, -0.1, -0.005)],
)  # fmt: skip
def test_no_torque_goes_further_than_the_engines_own_or_what_its_speed_needs(
    own: float | None, accelerates: float, wanted: float, given: float
) -> None:
    """By half a per cent beyond: J w' over the reference torque is needed for a speed that
    changes."""
    nm = wanted * ENGINE.reference_nm
    step = Step().ramp(3, own_nm=nm, left_nm=nm)
    step.context.torque.share = own
    step.seen.engine_rad_s2 = accelerates * ENGINE.reference_nm / ENGINE.inertia_kgm2
    step.seen.torque_step = 1e-6
    step.run()
    assert step.context.engine_share == pytest.approx(given, abs=1e-6)


PARTED_US = 50_000.0 - PARTING_S * 1e6
"""After a ramp's last step the plates may part when the engine has followed."""


@pytest.mark.parametrize(("off_us", "own", "may"), [
    (1.0, 0.1, True), (-1.0, 0.1, False),
    (1.0, 0.1 + LIMITS.torque_left_share - 1e-9, True),
    (1.0, 0.1 + LIMITS.torque_left_share + 1e-6, False),
    (1.0, -0.2, False),
    (LIMITS.ramp_ms * MS - 1.0, 0.4, False), (LIMITS.ramp_ms * MS + 1.0, 0.4, True),
])  # fmt: skip
def test_the_clutch_sets_off_so_that_its_plates_part_as_the_ramp_ends(
    off_us: float, own: float, may: bool
) -> None:
    """With as little as may be left beside what is asked for; after a while in any case."""
    step = Step().ramp(3, step_us=NOW_US - PARTED_US - off_us)
    step.context.torque.share = own
    step.left = 0.9
    assert step.run() is may


def test_an_engine_that_has_said_no_torque_yet_is_taken_to_have_none() -> None:
    step = Step().ramp(3, step_us=NOW_US - PARTED_US - 1.0, left_nm=0.0)
    step.context.torque.share = None
    assert step.run() is True


@pytest.mark.parametrize(("early_us", "steps"), [(1.0, False), (-1.0, True)])
def test_a_step_of_a_ramp_is_taken_half_a_period_after_the_last(
    early_us: float, steps: bool
) -> None:
    step = Step().ramp(1, step_us=NOW_US - HALF_US + early_us)
    step.seen.fitted = None
    step.run()
    ramp = step.unloading
    assert ramp.taken == (2 if steps else 1)
    assert bool(step.seen.fits) is steps
    if steps:
        assert ramp.step_us == NOW_US
        assert step.seen.asked == [pytest.approx(asked_share(2))]


def found(period: float, acceleration: float = -0.2) -> tuple[SwingFit, float]:
    """A fit by which engine and vehicle swing so much slower."""
    return SwingFit(KNOWN._replace(stiffness_nm_rad=16_000.0 / period**2), acceleration), OWN_NM


@pytest.mark.parametrize(
    ("passed", "slower", "steps"),
    [(1.01, 1.2, False), (1.19, 1.2, True), (1.01, 1.0, True), (1.49, 2.0, False),
     (1.51, 2.0, True)],
)  # fmt: skip
def test_a_step_is_put_off_where_the_swing_is_slower_but_not_beyond_one_and_a_half_times(
    passed: float, slower: float, steps: bool
) -> None:
    """Of what it was taken for; half a tick before its time it is taken."""
    step = Step().ramp(1, step_us=NOW_US - passed * HALF_US)
    step.seen.fitted = found(slower)
    step.run()
    assert step.unloading.taken == (2 if steps else 1)
    assert step.unloading.bodies.half_period_us == pytest.approx(slower * HALF_US)


@pytest.mark.parametrize(("left_us", "steps"), [(5_001.0, False), (4_999.0, True)])
def test_half_a_tick_before_its_time_a_step_is_taken(left_us: float, steps: bool) -> None:
    slower = 1.2
    step = Step().ramp(1, step_us=NOW_US - slower * HALF_US + left_us)
    step.seen.fitted = found(slower)
    step.run()
    assert step.unloading.taken == (2 if steps else 1)


def test_at_a_step_shafts_and_torque_to_end_at_are_found_anew() -> None:
    """From one period, or 0.4 s, before the ramp on; what is found is kept for the next shift."""
    step = Step().ramp(1, step_us=NOW_US - 1.1 * HALF_US)
    step.seen.fitted = found(0.9, acceleration=-0.35)
    step.run()
    fit, ramp = step.seen.fitted[0], step.unloading
    ((bodies, since_us),) = step.seen.fits
    assert bodies == BODIES
    began_us = NOW_US - 900 * MS
    assert since_us == pytest.approx(began_us - max(2.0 * HALF_US, 400 * MS))
    assert step.seen.learned == fit.known
    assert ramp.bodies == BODIES._replace(known=fit.known)
    pulled = BODIES.ratio * OWN_NM + BODIES.engine_kgm2 * 0.35
    coasting = -0.35 - pulled / 900.0
    assert ramp.left_nm == pytest.approx(BODIES.engine_kgm2 * coasting / BODIES.ratio)
    assert math.isclose(ramp.own_nm, OWN_NM)


def test_a_step_of_which_nothing_was_seen_is_taken_as_it_was_planned() -> None:
    step = Step().ramp(1, step_us=NOW_US - 1.1 * HALF_US)
    before, step.seen.fitted = step.unloading, None
    step.run()
    assert step.unloading == before._replace(taken=2, step_us=NOW_US)
    assert step.seen.learned is KNOWN


def test_a_slow_gears_ramp_is_found_anew_over_a_whole_period_before_it() -> None:
    slow = geared_bodies(SHEET, DRIVE_GEARS[1], KNOWN)
    step = Step().ramp(1, step_us=NOW_US - 1.1 * slow.half_period_us, bodies=slow)
    step.run()
    ((_, since_us),) = step.seen.fits
    assert 2.0 * slow.half_period_us > 400 * MS
    assert since_us == pytest.approx(NOW_US - 900 * MS - 2.0 * slow.half_period_us)
