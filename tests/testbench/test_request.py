"""`meshpoint request` beside a controller that answers as a test says, on a clock of its own."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator

import can
import pytest

import meshpoint.run.request as command
from meshpoint.base.exits import Exit
from meshpoint.bus.frames import frame_of
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ControllerState,
    ControllerStatus,
    FaultCode,
    Message,
    ShiftOutcome,
    ShiftResult,
)
from meshpoint.dbc.node import Node
from meshpoint.results.faults import MEANING, STALE_FAULTS, explain

GEAR = 10
Answer = Callable[["Bench"], Iterator[Message]]


def outcome(result: ShiftResult, fault: FaultCode = FaultCode.NONE) -> ShiftOutcome:
    return ShiftOutcome(
        from_gear=8,
        to_gear=GEAR,
        result=result,
        fault=fault,
        request_time_us=1_000_000,
        end_time_us=1_440_000,
    )


ENGAGED = outcome(ShiftResult.ENGAGED)
LATE_REFUSAL = outcome(ShiftResult.REFUSED, FaultCode.SPEED_STALE)


class Bench(can.BusABC):
    """A bus on which `answers` reply to one request each, the last one to all further ones, and
    the controller reports its status every 10 ms of its time, `speed` times as fast as the wall."""

    def __init__(
        self,
        *answers: list[Message],
        speed: float = 1.0,
        speaks: bool = True,
        stands: ControllerState = ControllerState.IN_GEAR,
    ) -> None:
        self.now_s = 500.0
        self.speed, self.speaks, self.stands = speed, speaks, stands
        self.asked = 0
        self._answers = answers
        self._queue: list[Frame] = []
        self._controller = Transmitter(Node.TRANSMISSION_CONTROL)
        self._receiver = Receiver(Node.TRANSMISSION_CONTROL)
        super().__init__(channel="scripted")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        asked = self._receiver.receive(frame_of(msg)).message
        assert isinstance(asked, TC1)
        assert asked.requested_gear == GEAR
        if self._answers:
            for answer in self._answers[min(self.asked, len(self._answers) - 1)]:
                self._queue.append(self._controller.encode(answer))
        self.asked += 1

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self._queue:
            frame = self._queue.pop(0)
        else:
            self.now_s += 0.01 / self.speed
            if not self.speaks:
                return None
            step_us = round(self.now_s * self.speed * 1e6)
            frame = self._controller.encode(
                ControllerStatus(step_time_us=step_us, state=self.stands, current_gear=8)
            )
        return can.Message(arbitration_id=frame.can_id, data=frame.data, is_fd=frame.is_fd)


def ask(
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    timeout: float = 10.0,
) -> tuple[int, str, str]:
    """The command's exit code, and what it printed and said."""
    monkeypatch.setattr(command, "open_bus_from", lambda _namespace: bench)
    monkeypatch.setattr(command.time, "monotonic", lambda: bench.now_s)
    code = command.run(argparse.Namespace(gear=GEAR, timeout=timeout, wire="fd"))
    printed, said = capsys.readouterr()
    return code, printed, said


def test_a_gear_that_engages_is_reported_with_its_time(monkeypatch, capsys) -> None:
    code, printed, said = ask(Bench([ENGAGED]), monkeypatch, capsys)
    assert (code, said) == (Exit.DONE, "")
    assert printed.startswith("8 -> 10: engaged after 440 ms")


def test_a_gear_whose_sleeve_was_aborted_is_reported_with_that(monkeypatch, capsys) -> None:
    engaged = ENGAGED._replace(attempts=1, aborts=2, halt_position_m=3.4e-3)
    _, printed, _ = ask(Bench([engaged]), monkeypatch, capsys)
    assert printed.strip().endswith("1 fired, aborted twice, last stood at 3.4 mm)")


def test_a_controller_that_waits_before_the_teeth_is_said_where_the_time_is_up(
    monkeypatch, capsys
) -> None:
    bench = Bench([LATE_REFUSAL], stands=ControllerState.HALTED)
    _, _, said = ask(bench, monkeypatch, capsys, timeout=3.0)
    assert said.splitlines()[-1].endswith("the controller stands waiting before the teeth")


@pytest.mark.parametrize("fault", sorted(STALE_FAULTS))
def test_a_refusal_because_a_node_was_late_is_explained_and_asked_again(
    fault: FaultCode, monkeypatch, capsys
) -> None:
    refusal = outcome(ShiftResult.REFUSED, fault)
    bench = Bench([refusal], [refusal], [refusal], [ENGAGED])
    code, printed, said = ask(bench, monkeypatch, capsys)
    assert code == Exit.DONE
    assert "8 -> 10: engaged" in printed
    assert bench.asked == 4
    assert said.count(fault.name.lower()) == 1, "once, not every time"
    for words in ("refused", MEANING[fault], "late", "--pace", "asking again"):
        assert words in said


def test_a_shift_that_ended_half_way_because_a_node_was_late_is_asked_again(
    monkeypatch, capsys
) -> None:
    ended = outcome(ShiftResult.ENDED_IN_NEUTRAL, FaultCode.POSITION_STALE)
    code, printed, said = ask(Bench([ended], [ENGAGED]), monkeypatch, capsys)
    assert code == Exit.DONE
    assert "engaged" in printed
    assert "ended in neutral" in said


def test_a_node_that_stays_late_ends_it_with_all_that_was_tried(monkeypatch, capsys) -> None:
    bench = Bench([LATE_REFUSAL])
    code, printed, said = ask(bench, monkeypatch, capsys, timeout=3.0)
    assert (code, printed) == (Exit.FAILED, "")
    last = said.splitlines()[-1]
    assert f"asked {bench.asked} times" in last
    assert f"{bench.asked} x speed_stale" in last
    assert "within 3 s" in last
    assert "in gear 8" in last, "where the controller stands"
    assert 3 < bench.asked < 30, "not without end"


@pytest.mark.parametrize("fault", sorted(set(FaultCode) - STALE_FAULTS - {FaultCode.NONE}))
def test_any_other_fault_is_final_and_says_what_it_means(
    fault: FaultCode, monkeypatch, capsys
) -> None:
    bench = Bench([outcome(ShiftResult.REFUSED, fault)], [ENGAGED])
    code, printed, said = ask(bench, monkeypatch, capsys)
    assert (code, printed, bench.asked) == (Exit.FAILED, "", 1)
    assert "8 -> 10: refused" in said
    assert explain(fault) in said


def test_every_fault_has_a_meaning() -> None:
    assert set(MEANING) == set(FaultCode)


@pytest.mark.parametrize("speed", [0.05, 1.0])
def test_the_timeout_is_counted_in_bus_time(speed: float, monkeypatch, capsys) -> None:
    """A bus that goes twenty times slower is given twenty times the wall time, but for the first
    0.01 s of it, until the controller is heard."""
    bench = Bench(speed=speed)
    began_s = bench.now_s
    code, _, said = ask(bench, monkeypatch, capsys, timeout=2.0)
    assert code == Exit.FAILED
    assert "did not end within 2 s" in said
    until_heard_s = 0.01 / speed
    passed_s = (bench.now_s - began_s - until_heard_s) * speed + until_heard_s
    assert passed_s == pytest.approx(2.0, abs=0.02)


def test_a_bus_faster_than_the_wall_is_given_the_wall_time(monkeypatch, capsys) -> None:
    bench = Bench(speed=100.0)
    began_s = bench.now_s
    ask(bench, monkeypatch, capsys, timeout=2.0)
    assert bench.now_s - began_s == pytest.approx(2.0, abs=0.05)


def test_a_bus_without_a_controller_is_said(monkeypatch, capsys) -> None:
    bench = Bench(speaks=False)
    began_s = bench.now_s
    code, _, said = ask(bench, monkeypatch, capsys, timeout=2.0)
    assert code == Exit.FAILED
    assert "no controller was heard" in said
    assert "meshpoint up" in said, "what to do is part of the message"
    assert bench.now_s - began_s == pytest.approx(2.0, abs=0.1)


def test_a_wait_for_a_controller_is_said_once(monkeypatch, capsys) -> None:
    _, _, said = ask(Bench(speaks=False), monkeypatch, capsys)
    assert said.count("no controller is heard on") == 1
    assert said.index("waits for 10 s") < said.index("no controller was heard")


def test_a_controller_that_falls_silent_is_said(monkeypatch, capsys) -> None:
    bench = Bench()
    speak = bench.recv

    def stops(timeout: float | None) -> can.Message | None:
        bench.speaks = bench.now_s < 501.0
        return speak(timeout)

    monkeypatch.setattr(bench, "recv", stops)
    code, _, said = ask(bench, monkeypatch, capsys, timeout=2.0)
    assert code == Exit.FAILED
    assert "silent" in said


def test_without_a_timeout_it_is_sent_once(monkeypatch, capsys) -> None:
    bench = Bench([LATE_REFUSAL])
    code, printed, _ = ask(bench, monkeypatch, capsys, timeout=0.0)
    assert (code, bench.asked, printed) == (Exit.DONE, 1, "asked for gear 10\n")


def test_a_controller_on_a_slow_machine_may_be_silent_for_longer(monkeypatch, capsys) -> None:
    bench = Bench()
    speak = bench.recv

    def pauses(timeout: float | None) -> can.Message | None:
        bench.speaks = not 501.0 < bench.now_s < 509.0
        return speak(timeout)

    monkeypatch.setattr(bench, "recv", pauses)
    monkeypatch.setattr("meshpoint.run.request.times_slower", lambda: 10.0)
    code, _, said = ask(bench, monkeypatch, capsys, timeout=2.0)
    assert "silent" not in said, code
