"""The phase of a gear, learned where it locks, against a gearbox whose true angles are known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.phase.reference import PhaseReferences
from meshpoint.gearbox import GearboxSheet, MainGear, load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.kinematics import wrap_to_pitch

TURN = 2.0 * math.pi
PITCH = TURN / 48
HALF_GAP = 0.2 * PITCH / 2.0
SHEET = load_sheet("thesis")


@dataclass
class Gearbox:
    """Wheels counted from any tooth, a gear's dog teeth at any angle to its own teeth.

    True gear angle = teeth_LS / teeth_gear x true layshaft angle + `mounted`; phase = true gear
    angle less true sleeve angle, modulo a pitch."""

    layshaft_teeth: int
    gear_teeth: int
    counted_from_ls: float
    counted_from_ms: float
    mounted: float

    def phase(self, theta_ls: float, theta_ms: float) -> float:
        """The true phase at counted angles."""
        true_ls, true_ms = theta_ls + self.counted_from_ls, theta_ms + self.counted_from_ms
        gear = true_ls * self.layshaft_teeth / self.gear_teeth + self.mounted
        return math.remainder(gear - true_ms, PITCH)

    def layshaft_at_phase(self, phase: float, theta_ms: float, tooth: int) -> float:
        """A counted layshaft angle at which the phase is `phase`."""
        true_ms = theta_ms + self.counted_from_ms
        gear = true_ms + phase + tooth * PITCH - self.mounted
        return gear * self.gear_teeth / self.layshaft_teeth - self.counted_from_ls


TEETH = {
    MainGear.CRAWL: (14, 51),
    MainGear.FIRST: (23, 50),
    MainGear.SECOND: (31, 40),
    MainGear.THIRD: (40, 31),
}
ANGLES = st.floats(-50.0, 50.0)


def lock(
    references: PhaseReferences, box: Gearbox, gear: MainGear, slip: float, theta_ms: float
) -> bool:
    """The gear lies on its flank and turns with the sleeve; looked at until learned."""
    references.locked(gear, slip)
    flank = math.copysign(HALF_GAP, slip)
    for measurement in range(20):
        at_ms = theta_ms + 0.6 * measurement
        # Turning together, the layshaft is at the same tooth of the same flank at every
        # measurement.
        theta_ls = box.layshaft_at_phase(flank, at_ms, 3)
        if references.watch(gear, theta_ls, at_ms):
            return True
    return False


@settings(deadline=None, max_examples=80)
@given(
    gear=st.sampled_from(MAIN_GEARS),
    angles=st.tuples(ANGLES, ANGLES, ANGLES, ANGLES),
    slip=st.floats(0.3, 5.0),
    sign=st.sampled_from([-1.0, 1.0]),
    later=st.tuples(st.floats(0.0, 50_000.0), st.floats(0.0, 50_000.0)),
)
def test_a_learned_phase_is_exact_at_every_later_angle(
    gear: MainGear,
    angles: tuple[float, float, float, float],
    slip: float,
    sign: float,
    later: tuple[float, float],
) -> None:
    """From any angles at start, on either flank, thousands of turns later."""
    box = Gearbox(*TEETH[gear], *angles[:3])
    references = PhaseReferences(SHEET)
    assert lock(references, box, gear, sign * slip, angles[3])
    seen = wrap_to_pitch(references.phase_rad(gear, *later), PITCH)
    assert abs(math.remainder(seen - box.phase(*later), PITCH)) < 1e-8


@pytest.mark.parametrize("gear", MAIN_GEARS)
def test_one_gear_learned_says_nothing_of_the_others(sheet: GearboxSheet, gear: MainGear) -> None:
    references = PhaseReferences(sheet)
    box = Gearbox(*TEETH[gear], 0.1, 0.2, 0.3)
    assert lock(references, box, gear, 1.0, 0.0)
    bits = {MainGear.CRAWL: 1, MainGear.FIRST: 2, MainGear.SECOND: 4, MainGear.THIRD: 8}
    assert references.mask == bits[gear]
    for other in MAIN_GEARS:
        assert references.known(other) is (other is gear)
        if other is not gear:
            with pytest.raises(KeyError):
                references.phase_rad(other, 0.0, 0.0)


def test_lost_counts_lose_every_reference(sheet: GearboxSheet) -> None:
    references = PhaseReferences(sheet)
    for gear in MAIN_GEARS:
        assert lock(references, Gearbox(*TEETH[gear], 0.1, 0.2, 0.3), gear, 1.0, 0.0)
    assert references.mask == 15
    references.lose_all()
    assert references.mask == 0
    with pytest.raises(KeyError):
        references.phase_rad(MainGear.SECOND, 0.0, 0.0)


def watched(box: Gearbox, shares: list[float], slip: float, pulled: bool) -> PhaseReferences:
    """A second gear that was seen at these places, in halves of the gap, one after the other."""
    references = PhaseReferences(SHEET)
    references.locked(MainGear.SECOND, slip)
    for share in shares:
        at = box.layshaft_at_phase(share * HALF_GAP, 5.0, 3)
        references.watch(MainGear.SECOND, at, 5.0, pulled)
    return references


def test_a_tooth_that_turns_round_amid_its_gap_lies_on_no_flank() -> None:
    """Thrown back by the lower flank it rises, slows down, and for 50 ms seems to lie still."""
    box = Gearbox(*TEETH[MainGear.SECOND], 0.1, 0.2, 0.3)
    turn = [-1.0, -0.6, -0.2, 0.03, 0.1, 0.12, 0.1, 0.03, -0.2, -0.6]
    assert not watched(box, turn, 1.0, pulled=False).known(MainGear.SECOND)


def test_one_look_gone_astray_by_an_impact_moves_no_tooth() -> None:
    box = Gearbox(*TEETH[MainGear.SECOND], 0.1, 0.2, 0.3)
    astray = [1.0] * 5 + [-0.7] + [1.0] * 20
    assert not watched(box, astray, -1.0, pulled=False).known(MainGear.SECOND)


@pytest.mark.parametrize("end", ["released", "lose_all"])
def test_a_gear_that_leaves_the_mesh_while_watched_is_not_learned(
    sheet: GearboxSheet, end: str
) -> None:
    references = PhaseReferences(sheet)
    references.locked(MainGear.SECOND, 1.0)
    assert not references.watch(MainGear.SECOND, 1.0, 1.0)
    getattr(references, end)()
    assert not any(references.watch(MainGear.SECOND, 1.0, 1.0) for _ in range(20))
    assert references.mask == 0


def test_noise_of_the_angles_averages_out(sheet: GearboxSheet) -> None:
    """Measurements that differ by less than half a pitch are of one tooth, also across the wrap."""
    references = PhaseReferences(sheet)
    box = Gearbox(*TEETH[MainGear.SECOND], 0.1, 0.2, 0.3)
    references.locked(MainGear.SECOND, 1.0)
    noise, learned, measurement = 0.0015, False, 0
    while not learned:
        at_ms = 0.6 * measurement
        theta_ls = box.layshaft_at_phase(HALF_GAP, at_ms, 3 + measurement)
        ripple = noise * (-1) ** measurement
        learned = references.watch(MainGear.SECOND, theta_ls + ripple, at_ms)
        measurement += 1
        assert measurement < 50
    error = references.phase_rad(MainGear.SECOND, 1.0, 2.0) - box.phase(1.0, 2.0)
    assert abs(math.remainder(error, PITCH)) < noise / 2.0


@settings(deadline=None)
@given(angle=st.floats(-1e4, 1e4))
def test_a_wrapped_angle_is_within_half_a_pitch(angle: float) -> None:
    wrapped = wrap_to_pitch(angle, PITCH)
    assert -PITCH / 2 - 1e-9 <= wrapped <= PITCH / 2 + 1e-9
    assert abs(math.remainder(wrapped - angle, PITCH)) < 1e-9


def test_a_flank_that_was_taken_for_the_other_is_put_right_when_the_whole_gap_was_seen() -> None:
    """Drag seemed to pull, but the driveline pressed the tooth to the upper flank; later the tooth
    is seen at both."""
    box = Gearbox(*TEETH[MainGear.SECOND], 0.3, -1.1, 0.7)
    references, main = PhaseReferences(SHEET), 12.0

    def measurement(phase: float, pulled: bool = False) -> None:
        angle = box.layshaft_at_phase(phase, main, 3)
        references.watch(MainGear.SECOND, angle, main, pulled)

    references.locked(MainGear.SECOND, -2.0)
    for phase in [HALF_GAP] * 3 + [-HALF_GAP] * 8:
        measurement(phase)
    references.locked(MainGear.SECOND, 2.0)
    for _ in range(8):
        measurement(HALF_GAP, pulled=True)
    angle = box.layshaft_at_phase(0.0, main, 3)
    wrong = wrap_to_pitch(references.phase_rad(MainGear.SECOND, angle, main), PITCH)
    assert abs(wrong) == pytest.approx(2.0 * HALF_GAP, rel=0.1)
    for phase in [-HALF_GAP] * 4 + [HALF_GAP] * 4:
        measurement(phase)
    references.released()
    right = wrap_to_pitch(references.phase_rad(MainGear.SECOND, angle, main), PITCH)
    assert abs(right) < 0.1 * HALF_GAP
