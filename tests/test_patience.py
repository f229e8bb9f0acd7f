"""What counts against the patience of a live test, and what does not."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys

import pytest
from patience import GrantedTime, Patience, family, until, until_async, waited_s

Stalls = dict[tuple[int, int], float]


class Machine:
    """A machine whose time and whose stalls a test decides."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.stalls: Stalls = {(1, 1): 5.0, (2, 2): 7.0}

    def meter(self) -> GrantedTime:
        return GrantedTime(lambda: self.now_s, lambda: dict(self.stalls), look_every_s=0.1)

    def passes(self, wall_s: float, **waited_s: float) -> None:
        self.now_s += wall_s
        for name, seconds in waited_s.items():
            thread = (int(name[1:]), int(name[1:]))
            self.stalls[thread] = self.stalls.get(thread, 0.0) + seconds


def test_on_a_quiet_machine_all_time_counts() -> None:
    machine = Machine()
    meter = machine.meter()
    for _ in range(10):
        machine.passes(1.0)
        meter()
    assert meter() == pytest.approx(10.0)


def test_time_in_which_one_of_ours_waits_for_a_processor_does_not_count() -> None:
    machine = Machine()
    meter = machine.meter()
    machine.passes(1.0, p1=0.2, p2=0.75)
    assert meter() == pytest.approx(0.25)
    assert meter.stalled_s == pytest.approx(0.75)
    machine.passes(1.0)
    assert meter() == pytest.approx(1.25)


def test_no_more_is_forgiven_than_has_passed_and_a_new_process_counts_from_its_birth() -> None:
    machine = Machine()
    meter = machine.meter()
    machine.passes(1.0, p1=9.0)
    assert meter() == 0.0
    machine.passes(1.0, p3=0.5)
    assert meter() == pytest.approx(0.5)
    del machine.stalls[1, 1]
    machine.passes(1.0)
    assert meter() == pytest.approx(1.5)


def test_where_no_kernel_tells_of_stalls_the_wall_counts() -> None:
    machine = Machine()
    machine.stalls = {}
    meter = machine.meter()
    machine.passes(3.0)
    assert meter() == pytest.approx(3.0)


def test_a_family_is_all_that_descend_from_one() -> None:
    assert family(2, [(2, 1), (3, 2), (4, 3), (5, 1), (6, 4)]) == {2, 3, 4, 6}


def test_patience_ends_with_what_was_awaited_and_what_was_seen() -> None:
    machine = Machine()
    patience = Patience(10.0, machine.meter())
    machine.passes(9.0)
    patience.check("a frame")
    machine.passes(60.0, p2=59.5)
    patience.check("a frame")
    assert patience.spent_s == pytest.approx(9.5)
    machine.passes(1.0)
    with pytest.raises(AssertionError, match=r"a frame: not within 10 s .*saw two"):
        patience.check("a frame", lambda: "saw two")


def test_waiting_ends_with_the_condition_or_with_the_patience() -> None:
    machine = Machine()
    tries = iter([False, False, True])
    until(lambda: next(tries), "the third", poll_s=0.0)
    again = iter([False, True])
    asyncio.run(until_async(lambda: next(again), "the second", poll_s=0.0))

    def never() -> bool:
        machine.passes(1.0)
        return False

    with pytest.raises(AssertionError, match="never"):
        until(never, "never", patience=Patience(3.0, machine.meter()), poll_s=0.0)
    with pytest.raises(AssertionError, match="never"):
        asyncio.run(
            until_async(never, "never", patience=Patience(3.0, machine.meter()), poll_s=0.0)
        )


def test_patience_by_the_time_of_a_bus() -> None:
    bus_s = 5.0
    patience = Patience(2.0, lambda: bus_s)
    bus_s = 6.9
    patience.check("a gear")
    bus_s = 7.1
    with pytest.raises(AssertionError, match="a gear"):
        patience.check("a gear")


@pytest.mark.skipif(not waited_s(os.getpid()), reason="this kernel does not tell of stalls")
def test_children_that_crowd_each_other_out_are_seen() -> None:
    """More busy processes than processors: some of them always wait."""
    crowd = [
        subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"])
        for _ in range(len(os.sched_getaffinity(0)) + 2)
    ]
    try:
        meter = GrantedTime()
        until(lambda: meter() >= 0.0 and meter.stalled_s > 0.3, "a stall of 0.3 s")
    finally:
        for one in crowd:
            one.kill()
            one.wait()
