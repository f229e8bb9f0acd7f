"""Tests of shifts: the same ones in virtual time, on two processes, on a vcan, on an adapter.

    pytest examples/test_shifts.py
    pytest examples/test_shifts.py --meshpoint-backend processes
    pytest examples/test_shifts.py --meshpoint-backend vcan
    pytest examples/test_shifts.py --meshpoint-backend adapter \\
        --meshpoint-interface socketcan --meshpoint-channel can0
"""

import pytest

from meshpoint import messages

pytestmark = pytest.mark.meshpoint(preset="thesis", seed=3, shared=True)


@pytest.fixture
def shift(bench):
    """The first shift of this file's bench; it is made once."""
    return bench.shifts[0] if bench.shifts else bench.shift(10)


def test_the_gear_is_engaged(shift):
    assert (shift.from_, shift.to, shift.result) == (8, 10, "engaged")


def test_it_ends_in_time(shift):
    assert shift.duration_ms < 1200


def test_no_fault_was_active(shift):
    assert shift.fault == "none"


def test_one_attempt_was_enough_and_the_sleeve_was_not_stopped_on_its_way(shift):
    assert (shift.attempts, shift.aborts) == (1, 0)


def test_the_contact_is_a_tooth_or_a_gap(shift):
    assert shift.contact in ("gap", "tooth")


def test_the_slip_at_contact_is_small(shift):
    assert abs(shift.slip_rpm) < 60


def test_the_first_engagement_of_a_gear_cannot_aim(shift):
    assert shift.reference == "unknown"


def test_the_controller_stands_in_the_new_gear(bench, shift):
    bench.run_until(lambda bench: bench.status.state is messages.ControllerState.IN_GEAR)
    assert bench.status.current_gear == 10


def test_the_guard_has_blocked_nothing(bench, shift):
    assert bench.status.guard_blocks == 0


def test_the_brake_is_off(bench, shift):
    assert not bench.latest(messages.ValveStatus).brake_energised
