"""Diagnosis as a garage's tools see it: can-j1939, and udsoncan over can-isotp, are the peers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import can
import isotp
import j1939
import pytest
import udsoncan
from patience import until
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection

from meshpoint.bus.core import Step
from meshpoint.bus.diagnosis.address import AddressClaim, Name
from meshpoint.bus.diagnosis.core import DiagnosedCore
from meshpoint.bus.diagnosis.diagnostic_messages import DM2, DiagnosticMessages
from meshpoint.bus.diagnosis.transport import IsoTp
from meshpoint.bus.diagnosis.trouble_codes import FAILURE_MODE, FIRST_SPN, TroubleMemory
from meshpoint.bus.frames import frame_of, message_of
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import ControllerStatus, FaultCode
from meshpoint.dbc.node import Node

CONTROLLER, TESTER = 0x03, 0xF1
LOW_SUPPLY = FIRST_SPN + int(FaultCode.LOW_SUPPLY)


class Controller:
    """A node that says what a test wants said, every 10 ms."""

    def __init__(self) -> None:
        self.fault = FaultCode.NONE
        self.heard: list[Frame] = []
        self.next_step_us = 0
        self._sender = Transmitter(Node.TRANSMISSION_CONTROL)

    def receive(self, frame: Frame) -> None:
        self.heard.append(frame)

    def step(self, now_us: int) -> Step:
        self.next_step_us = now_us + 10_000
        status = ControllerStatus(
            active_fault=self.fault,
            current_gear=8,
            run_hash_high=0x01020304,
            run_hash_low=0xAABBCCDD,
        )
        return Step([self._sender.encode(status)], [])

    def shutdown(self, now_us: int) -> Step:
        return Step([Frame(0x0CFF4003, bytes(48))], ["valves off"])


class Running:
    """The node on a python-can bus, stepped by a thread."""

    def __init__(self, channel: str) -> None:
        self.controller = Controller()
        self.core = DiagnosedCore(self.controller, "1.2.3")
        self._bus = can.Bus(channel, interface="virtual")
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            message = self._bus.recv(0.002)
            if message is not None:
                self.core.receive(frame_of(message))
            now_us = time.monotonic_ns() // 1000
            if now_us < self.core.next_step_us:
                continue
            for frame in self.core.step(now_us).frames:
                self._bus.send(message_of(frame))

    def end(self) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.shutdown()


@pytest.fixture
def running(request: pytest.FixtureRequest) -> Iterator[tuple[Running, str]]:
    channel = request.node.name
    node = Running(channel)
    yield node, channel
    node.end()


class Garage:
    """A can-j1939 tester on the same bus."""

    def __init__(self, channel: str) -> None:
        self.ecu = j1939.ElectronicControlUnit()
        self.ecu.connect(interface="virtual", channel=channel)
        name = j1939.Name(identity_number=7, manufacturer_code=1, function=129)
        self.application = j1939.ControllerApplication(name, 0xF9)
        self.ecu.add_ca(controller_application=self.application)
        self.application.start()
        self.codes: list[dict[str, int]] | None = None
        self.lamps: dict[str, int] = {}
        j1939.Dm1(self.application).subscribe(self._dm1)

    def _dm1(self, source: int, lamps, codes, _timestamp) -> None:
        if source == CONTROLLER:
            self.lamps, self.codes = lamps, codes

    def end(self) -> None:
        self.application.stop()
        self.ecu.disconnect()


@pytest.fixture
def garage(running: tuple[Running, str]) -> Iterator[Garage]:
    tool = Garage(running[1])
    yield tool
    tool.end()


def test_faults_are_reported_as_dm1_and_cleared_by_dm3(running, garage: Garage) -> None:
    node, _ = running
    until(lambda: garage.codes is not None, "a DM1 of a node that has nothing to tell")
    node.controller.fault = FaultCode.LOW_SUPPLY
    until(lambda: [c["spn"] for c in garage.codes or []] == [LOW_SUPPLY], "the active code")
    until(lambda: garage.lamps.get("awl") == j1939.DtcLamp.ON, "the lamp of the same frame")
    assert garage.codes == [{"spn": LOW_SUPPLY, "fmi": 1, "oc": 1}]
    node.controller.fault = FaultCode.NONE
    until(lambda: [c["spn"] for c in garage.codes or []] == [0], "no active code any more")
    assert [code.spn for code in node.core.memory.stored] == [LOW_SUPPLY]
    normal = j1939.ControllerApplication.State.NORMAL
    until(lambda: garage.application.state == normal, "the tool has claimed its address")
    garage.application.send_request(0, 0xFECC, CONTROLLER)
    until(lambda: not node.core.memory.codes, "cleared")


def test_the_address_is_claimed_when_it_starts_and_when_it_is_asked(running) -> None:
    """can-j1939 keeps claims to itself: they are received here, and its NAME reads them."""
    with can.Bus(running[1], interface="virtual") as bus:
        bus.send(can.Message(arbitration_id=0x18EAFFF9, data=[0x00, 0xEE, 0x00]))
        claims: list[can.Message] = []

        def claimed() -> bool:
            message = bus.recv(0.05)
            if message is not None and message.arbitration_id == 0x18EEFF03:
                claims.append(message)
            return bool(claims)

        until(claimed, "an answer")
    reported = j1939.Name(bytes=list(claims[0].data))
    assert (reported.function, reported.arbitrary_address_capable) == (3, 0)
    assert reported.industry_group == j1939.Name.IndustryGroup.OnHighway
    assert reported.identity_number == 1


class Number(udsoncan.DidCodec):
    def decode(self, payload: bytes) -> int:
        return int.from_bytes(payload, "big")

    def __len__(self) -> int:
        return self.size

    def __init__(self, size: int) -> None:
        self.size = size


@pytest.fixture
def tester(running) -> Iterator[Client]:
    bus = can.Bus(running[1], interface="virtual")
    address = isotp.Address(
        isotp.AddressingMode.NormalFixed_29bits, source_address=TESTER, target_address=CONTROLLER
    )
    stack = isotp.CanStack(bus, address=address, params={"blocking_send": False})
    config = dict(udsoncan.configs.default_client_config)
    config |= {
        "request_timeout": 30, "p2_timeout": 30, "use_server_timing": False,
        "data_identifiers": {0xF195: udsoncan.AsciiCodec(5), 0xF1A0: Number(8), 0x0100: Number(1),
                             0x0BAD: Number(1)},
    }  # fmt: skip
    with Client(PythonIsoTpConnection(stack), config=config) as client:
        yield client
    bus.shutdown()


def test_udsoncan_reads_data_over_several_frames(running, tester: Client) -> None:
    until(
        lambda: running[0].core.memory is not None and running[0].core._status.current_gear == 8, ""
    )
    values = tester.read_data_by_identifier([0xF195, 0xF1A0, 0x0100]).service_data.values
    assert values == {0xF195: "1.2.3", 0xF1A0: 0x01020304AABBCCDD, 0x0100: 8}
    assert tester.tester_present().positive
    assert tester.change_session(3).positive
    with pytest.raises(udsoncan.NegativeResponseException) as refused:
        tester.read_data_by_identifier(0x0BAD)
    assert refused.value.response.code == udsoncan.Response.Code.RequestOutOfRange
    with pytest.raises(udsoncan.NegativeResponseException) as refused:
        tester.ecu_reset(1)
    assert refused.value.response.code == udsoncan.Response.Code.ServiceNotSupported


def test_udsoncan_reads_and_clears_codes(running, tester: Client) -> None:
    node = running[0]
    for fault in (FaultCode.CLUTCH_STUCK, FaultCode.RANGE_FAILED, FaultCode.LOW_SUPPLY):
        node.controller.fault = fault
        until(lambda f=fault: [c.fault for c in node.core.memory.active] == [f], "taken")
    read = tester.get_dtc_by_status_mask(0xFF).service_data
    codes = {code.id: code.status for code in read.dtcs}
    packed = {int.from_bytes(code.packed, "big") for code in node.core.memory.codes}
    assert set(codes) == packed
    assert len(codes) == 3
    assert sum(status.test_failed for status in codes.values()) == 1
    assert tester.get_number_of_dtc_by_status_mask(0x01).service_data.dtc_count == 1
    assert tester.clear_dtc().positive
    assert [code.fault for code in node.core.memory.codes] == [FaultCode.LOW_SUPPLY]


def claim(name: Name, address: int = CONTROLLER) -> Frame:
    return Frame(0x18EEFF00 | address, name.number.to_bytes(8, "little"), is_fd=False)


def test_the_smaller_name_keeps_the_address_and_the_other_falls_silent() -> None:
    core = DiagnosedCore(Controller(), "1")
    assert claim(Name()) in core.step(0).frames
    core.receive(claim(Name(identity=2)))
    kept = core.step(10_000)
    assert claim(Name()) in kept.frames
    assert "ours is kept" in kept.events[0]
    core.receive(claim(Name(identity=0)))
    lost = core.step(20_000)
    assert [f.can_id for f in lost.frames] == [0x18EEFFFE], "cannot claim, and nothing else"
    assert "silent from now on" in lost.events[0]
    assert core.step(30_000).frames == []
    assert core.shutdown(40_000).frames == [], (
        "not even valves off: the valves expire by themselves"
    )


def test_its_own_claim_returned_by_the_interface_is_none_of_another() -> None:
    held = AddressClaim(Name())
    assert held.hear(claim(Name())) is None
    assert held.is_held


def test_diagnosis_stays_outside_of_the_controller() -> None:
    inner = Controller()
    core = DiagnosedCore(inner, "1")
    for can_id in (0x18EA0321, 0x18EEFF21, 0x18DA03F1):
        core.receive(Frame(can_id, bytes(8), is_fd=False))
    passed = Frame(0x0C0103F9, bytes(8), is_fd=False)
    core.receive(passed)
    assert inner.heard == [passed]


@pytest.mark.parametrize("fault", FAILURE_MODE)
def test_each_code_is_read_by_can_j1939_as_it_was_written(fault: FaultCode) -> None:
    memory = TroubleMemory()
    assert memory.take(fault)
    assert not memory.take(fault), "no news"
    memory.take(FaultCode.NONE)
    memory.take(fault)
    (code,) = memory.active
    read = j1939.DTC(dtc=int.from_bytes(code.counted, "little"))
    assert (read.spn, read.fmi, read.oc) == (code.spn, FAILURE_MODE[fault], 2)


def test_a_request_that_should_not_have_been_made_is_no_trouble_code() -> None:
    memory = TroubleMemory()
    refusals = set(FaultCode) - set(FAILURE_MODE)
    assert FaultCode.REQUEST_IMPOSSIBLE in refusals
    for fault in refusals:
        memory.take(fault)
    assert memory.codes == []


def test_many_stored_codes_go_out_by_broadcast_transport_50_ms_apart() -> None:
    memory = TroubleMemory()
    for fault in (*FAILURE_MODE, FaultCode.NONE):
        memory.take(fault)
    messages = DiagnosticMessages(memory)
    messages.take_frames(0)
    messages.hear(Frame(0x18EA03F9, DM2.to_bytes(3, "little"), is_fd=False))
    sent: list[tuple[int, Frame]] = []
    for now_us in range(0, 900_000, 10_000):
        sent += [(now_us, frame) for frame in messages.take_frames(now_us)]
    announced, *packets = sent
    size = announced[1].data[1]
    assert announced[1].can_id == 0x1CECFF03
    assert size == 2 + 4 * len(FAILURE_MODE)
    assert [f.data[0] for _, f in packets] == list(range(1, announced[1].data[3] + 1))
    whole = b"".join(f.data[1:] for _, f in packets)[:size]
    assert whole[2:] == b"".join(code.counted for code in memory.stored)
    gaps = {b - a for (a, _), (b, _) in pairwise(packets)}
    assert gaps == {50_000}


def exchange(first: IsoTp, second: IsoTp, lose: Callable[[int], bool]) -> bytes | None:
    got, count = None, 0
    for now_us in range(0, 200_000, 1_000):
        for sender, receiver in ((first, second), (second, first)):
            for frame in sender.take_frames(now_us):
                count += 1
                if not lose(count):
                    got = receiver.hear(frame.data, now_us) or got
    return got


@pytest.mark.parametrize("length", [1, 7, 8, 13, 14, 200, 4095])
def test_a_message_of_any_length_comes_through_or_not_at_all(length: int) -> None:
    data = bytes(k % 251 for k in range(length))
    for lost in (0, 2, 3, 5):
        sender, receiver = IsoTp(1), IsoTp(2)
        sender.send(data, 0)
        got = exchange(sender, receiver, lambda n, lost=lost: n == lost)
        if lost == 0:
            assert got == data
        else:
            assert got in (None, data)


def test_garbage_is_survived() -> None:
    link = IsoTp(1)
    for kind in range(256):
        for rest in (b"", b"\x00", bytes(7), b"\xff" * 7):
            link.hear(bytes([kind]) + rest, 0)
            link.take_frames(0)
    assert link.hear(b"", 0) is None
