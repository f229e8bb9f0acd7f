"""The phase of a gear, learned where it locks, against a gearbox whose true angles are known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.estimate.reference import PhaseReferences
from meshpoint.controller.estimate.reference_recovery import LockedGear
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.swing import ShaftState
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.kinematics import wrap_to_pitch

TURN = 2.0 * math.pi
PITCH = TURN / 48
GAP = 0.2 * PITCH
HALF_GAP = GAP / 2.0
SD = 0.1 * GAP
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
    while references.watches(gear):
        at_ms = theta_ms + 0.6 * references.watched.measurements
        # Turning together, the layshaft is at the same tooth of the same flank at every
        # measurement.
        theta_ls = box.layshaft_at_phase(flank, at_ms, 3)
        references.measure(gear, theta_ls, at_ms, SD)
        if references.settle(gear):
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
def test_a_learned_phase_is_known_at_every_later_angle(
    gear: MainGear,
    angles: tuple[float, float, float, float],
    slip: float,
    sign: float,
    later: tuple[float, float],
) -> None:
    """From any angles at start, on either flank, thousands of turns later: to a twentieth of the
    gap, though the tooth has shown one of its flanks alone."""
    box = Gearbox(*TEETH[gear], *angles[:3])
    references = PhaseReferences(SHEET)
    assert lock(references, box, gear, sign * slip, angles[3])
    seen = wrap_to_pitch(references.phase_rad(gear, *later), PITCH)
    assert abs(math.remainder(seen - box.phase(*later), PITCH)) < 0.05 * GAP


@pytest.mark.parametrize("gear", MAIN_GEARS)
def test_one_gear_learned_says_nothing_of_the_others(gear: MainGear) -> None:
    references = PhaseReferences(SHEET)
    assert lock(references, Gearbox(*TEETH[gear], 0.1, 0.2, 0.3), gear, 1.0, 0.0)
    bits = {MainGear.CRAWL: 1, MainGear.FIRST: 2, MainGear.SECOND: 4, MainGear.THIRD: 8}
    assert references.mask == bits[gear]
    for other in MAIN_GEARS:
        assert references.known(other) is (other is gear)
        if other is not gear:
            with pytest.raises(KeyError):
                references.phase_rad(other, 0.0, 0.0)


BOX = Gearbox(*TEETH[MainGear.SECOND], 0.1, 0.2, 0.3)
GEAR, OTHER = MainGear.SECOND, MainGear.THIRD


def see(references: PhaseReferences, *shares: float, tooth: int = 3, sd: float = 0.1) -> list[bool]:
    """Measurements of second gear at these places, in halves of the gap from its middle; whether
    each has shown a reference."""
    shown = []
    for share in shares:
        layshaft = BOX.layshaft_at_phase(share * HALF_GAP, 5.0, tooth)
        references.measure(GEAR, layshaft, 5.0, sd * GAP)
        shown.append(references.settle(GEAR))
    return shown


def error_share(references: PhaseReferences) -> float:
    """Error of the reference of second gear, in gaps."""
    seen = references.phase_rad(GEAR, BOX.layshaft_at_phase(0.0, 5.0, 3), 5.0)
    return abs(math.remainder(seen, PITCH)) / GAP


@pytest.mark.parametrize("slip", [0.0, 0.19, -0.19])
def test_a_tooth_that_lies_still_is_at_either_flank_where_the_slip_does_not_say_at_which(
    slip: float,
) -> None:
    """Below 2 rpm its sign is not certain: one of two middles, and not to be remembered."""
    references = PhaseReferences(SHEET)
    for _ in range(3):
        references.locked(GEAR, slip)
        see(references, *[1.0] * 60)
        references.released()
    assert references.known(GEAR)
    assert 0.4 * GAP < references.sd_rad(GEAR) < 0.8 * GAP
    assert not references.certain(GEAR)
    assert references.offsets_rad == {}


def test_a_tooth_that_goes_to_and_fro_shows_its_gap_whatever_the_slip() -> None:
    references = PhaseReferences(SHEET)
    references.locked(GEAR, 0.0)
    assert sum(see(references, *([1.0] * 5 + [-1.0] * 5) * 3)) == 1
    assert error_share(references) < 0.03
    assert 0.0 < references.sd_rad(GEAR) < 0.1 * GAP
    assert references.source(GEAR) is ReferenceSource.MEASURED


def test_two_engagements_some_teeth_apart_show_the_same_gap() -> None:
    """Phases of one gear differ by whole pitches from one engagement to the next."""
    references = PhaseReferences(SHEET)
    for tooth, flank in ((3, 1.0), (8, -1.0)):
        assert not references.certain(GEAR)
        references.locked(GEAR, 0.0)
        see(references, *[flank] * 30, tooth=tooth)
    assert references.certain(GEAR)
    assert error_share(references) < 0.03


def test_a_measurement_gone_astray_by_an_impact_moves_no_reference() -> None:
    references = PhaseReferences(SHEET)
    references.locked(GEAR, 0.0)
    see(references, *[1.0] * 5, -0.4, *[1.0] * 40)
    assert not references.certain(GEAR)
    references.locked(GEAR, 1.0)
    see(references, *[1.0] * 5, -3.0, *[1.0] * 20)
    assert error_share(references) < 0.05


def test_a_flank_taken_for_the_other_is_put_right_when_the_whole_gap_was_seen() -> None:
    references = PhaseReferences(SHEET)
    references.locked(GEAR, -1.0)
    see(references, *[1.0] * 30)
    assert error_share(references) == pytest.approx(1.0, abs=0.1)
    references.locked(GEAR, 0.0)
    assert sum(see(references, *([-1.0] * 6 + [1.0] * 6) * 3)) == 1, "it is another one, once"
    assert error_share(references) < 0.05


@pytest.mark.parametrize("sd", [0.3, 0.6, 1.2])
def test_measurements_that_scatter_count_by_their_deviation(sd: float) -> None:
    """So that a gear whose sensors are poor is known too, and said to be known less well."""
    references = PhaseReferences(SHEET)
    references.locked(GEAR, 1.0)
    assert any(see(references, *[1.0] * 20, sd=sd))
    assert error_share(references) * GAP < 2.0 * references.sd_rad(GEAR)
    assert references.sd_rad(GEAR) > 0.3 * sd * GAP


def test_measurements_that_say_nothing_of_a_gap_do_not_count_and_that_is_said() -> None:
    """Nor do they use up what the slip says."""
    references, events = PhaseReferences(SHEET), list[str]()
    locked = LockedGear(SHEET, references, None)
    assert references.source(GEAR) is ReferenceSource.NONE
    references.locked(GEAR, 1.0)
    assert not any(see(references, *[1.0] * 20, sd=7.0))
    locked.released(events)
    assert references.source(GEAR) is ReferenceSource.UNSEEN
    assert events == ["phase reference of second not learned: its tooth was not seen in mesh"]
    references.locked(GEAR, 1.0)
    assert any(see(references, *[1.0] * 20))
    assert references.source(GEAR) is ReferenceSource.MEASURED
    assert error_share(references) < 0.05


def test_a_gear_is_looked_at_for_a_while_and_no_longer() -> None:
    references, looks = PhaseReferences(SHEET), 0
    references.locked(GEAR, 0.0)
    assert not references.watches(OTHER)
    while references.watches(GEAR):
        see(references, 0.3 * math.sin(looks))
        looks += 1
    assert looks == 60


@pytest.mark.parametrize("end", ["released", "lose_all"])
def test_a_gear_that_has_left_the_mesh_is_learned_no_more(end: str) -> None:
    references = PhaseReferences(SHEET)
    references.locked(GEAR, 1.0)
    getattr(references, end)()
    assert not any(see(references, *[1.0] * 20))
    assert references.mask == 0
    assert references.watched is None


def test_one_of_two_flanks_does_not_replace_what_was_adopted() -> None:
    """What was remembered says which; a tooth that shows both replaces it."""
    references = PhaseReferences(SHEET)
    references.adopt(GEAR, 0.01, ReferenceSource.RESTORED)
    references.locked(GEAR, 0.0)
    assert not any(see(references, *[1.0] * 30))
    assert references.source(GEAR) is ReferenceSource.RESTORED
    assert references.sd_rad(GEAR) == 0.0
    assert sum(see(references, *[-1.0] * 30)) == 1
    assert references.source(GEAR) is ReferenceSource.MEASURED
    assert references.released() is GEAR
    assert references.released() is None


def test_a_gear_in_mesh_says_more_than_what_was_adopted() -> None:
    references = PhaseReferences(SHEET)
    references.adopt(GEAR, 0.01, ReferenceSource.RESTORED)
    references.adopt(OTHER, 0.02, ReferenceSource.NARROWED)
    assert references.source(GEAR) is ReferenceSource.RESTORED
    references.locked(GEAR, 1.0)
    assert sum(see(references, *[1.0] * 60)) == 1
    assert references.source(GEAR) is ReferenceSource.MEASURED
    assert error_share(references) < 0.05
    references.lose(GEAR)
    references.lose(GEAR)
    assert references.offsets_rad == {OTHER: 0.02}
    assert references.source(GEAR) is ReferenceSource.NONE
    references.locked(GEAR, 0.0)
    see(references, *[1.0] * 20)
    assert not references.certain(GEAR), "nothing is left of what was seen of it"


def test_lost_counts_lose_every_reference_and_all_that_was_seen() -> None:
    references = PhaseReferences(SHEET)
    for gear in MAIN_GEARS:
        assert lock(references, Gearbox(*TEETH[gear], 0.1, 0.2, 0.3), gear, 1.0, 0.0)
    references.adopt(OTHER, 0.01, ReferenceSource.RESTORED)
    assert references.mask == 15
    references.lose_all()
    assert references.mask == 0
    assert references.source(OTHER) is ReferenceSource.NONE
    with pytest.raises(KeyError):
        references.phase_rad(MainGear.SECOND, 0.0, 0.0)
    references.locked(GEAR, 0.0)
    see(references, *[1.0] * 30)
    assert not references.certain(GEAR)


@pytest.mark.parametrize(
    ("every_ms", "looks", "known"),
    [(5, 37, False), (5, 39, True), (10, 19, False), (10, 20, True), (20, 10, False),
     (20, 11, True)],
)  # fmt: skip
def test_nothing_is_concluded_of_a_gear_in_its_first_fifth_of_a_second_but_at_its_release(
    every_ms: int, looks: int, known: bool
) -> None:
    """Its tooth may still be on its way to a flank. Red before: twenty steps were waited for, of
    whatever tick."""
    references, events = PhaseReferences(SHEET), list[str]()
    locked = LockedGear(SHEET, references, None)
    references.locked(GEAR, 1.0)
    theta = BOX.layshaft_at_phase(HALF_GAP, 5.0, 3)
    for look in range(looks):
        at_us = 1e6 + 1e3 * every_ms * look
        layshaft = LayshaftState(at_us, theta, 90.0, 0.0, 0.02 * GAP, 0.1)
        locked.measure(GEAR, layshaft, ShaftState(at_us, 5.0, 70.0, 0.1 * GAP, 0.1), events)
    assert references.known(GEAR) is known
    locked.released(events)
    locked.released(events)
    assert references.known(GEAR)
    assert events == ["phase reference of second learned"]
    assert error_share(references) < 0.05


@settings(deadline=None)
@given(angle=st.floats(-1e4, 1e4))
def test_a_wrapped_angle_is_within_half_a_pitch(angle: float) -> None:
    wrapped = wrap_to_pitch(angle, PITCH)
    assert -PITCH / 2 - 1e-9 <= wrapped <= PITCH / 2 + 1e-9
    assert abs(math.remainder(wrapped - angle, PITCH)) < 1e-9
