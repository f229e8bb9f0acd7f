"""`meshpoint check`: what it says of links, messages, stamps, sensors, shafts; its answer."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import can
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from live_command import live
from patience import until

import meshpoint.commission.check_command as command
from meshpoint.bus.frames import message_of
from meshpoint.bus.profile import WireProfile
from meshpoint.cli.main import main
from meshpoint.commission.finding import Finding, Verdict, answer
from meshpoint.commission.interface import LinkError, judge_link, link_of
from meshpoint.commission.listener import Listener
from meshpoint.commission.shafts import Shaft, judge_turned
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import EdgesInputRise, EdgesLayshaftRise, EdgesMainRise, GearboxSensors
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, RigSettings

SHEET = load_sheet("truck12")
SECONDS = 4.0
Timed = tuple[float, Frame]


@pytest.fixture(scope="module")
def driving() -> list[Timed]:
    """A rig in gear 8, and when each frame came."""
    rig = RigCore(SHEET, RigSettings(preset=Preset.THESIS, seed=1, start_gear=8))
    frames: list[Timed] = []
    while rig.next_step_us < SECONDS * 1e6:
        now_us = rig.next_step_us
        frames += [(100.0 + now_us * 1e-6, frame) for frame in rig.step(now_us).frames]
    return frames


def heard(frames: list[Timed], sheet=SHEET) -> Listener:
    listener = Listener(sheet)
    for time_s, frame in frames:
        listener.take(time_s, message_of(frame, time_s))
    return listener


def found(listener: Listener) -> dict[str, Finding]:
    return {finding.subject: finding for finding in listener.findings()}


def bad(listener: Listener) -> list[str]:
    return [f.subject for f in listener.findings() if f.verdict is Verdict.BAD]


def rewired(frames: list[Timed], change) -> list[Timed]:
    """The same bus with another sensor side: `change` gets each message and returns one or None."""
    receiver, sender = Receiver(*Node), Transmitter(Node.GEARBOX_IO, Node.ENGINE, Node.REFERENCE)
    result = []
    for time_s, frame in frames:
        decoded = receiver.receive(frame).message
        changed = None if decoded is None else change(decoded)
        if changed is not None:
            result.append((time_s, sender.encode(changed)))
    return result


def test_a_rig_that_turns_is_good_in_everything_that_can_be_known(driving) -> None:
    listener = heard(driving)
    assert bad(listener) == []
    reported = found(listener)
    for pair in ("input to layshaft, splitter high", "layshaft to main, main gear first"):
        assert reported[pair].verdict is Verdict.GOOD
    assert reported["EdgesMainRise"].text.startswith("100.")
    assert reported["drift"].verdict is Verdict.GOOD
    assert "all off" in reported["valves"].text


def test_a_wheel_with_another_tooth_count_is_named_with_the_one_that_would_fit(driving) -> None:
    wheels = replace(SHEET.wheels, main=replace(SHEET.wheels.main, teeth=48))
    listener = heard(driving, replace(SHEET, wheels=wheels))
    text = found(listener)["layshaft to main, main gear first"].text
    assert "main 45.0" in text
    assert sorted(bad(listener)) == [
        "layshaft to main, main gear first",
        "main to propeller, range high",
    ]


def test_two_sensors_in_each_others_place_are_no(driving) -> None:
    swap = {EdgesLayshaftRise: EdgesMainRise, EdgesMainRise: EdgesLayshaftRise}
    listener = heard(rewired(driving, lambda m: swap.get(type(m), type(m))._make(m)))
    assert "layshaft to main, main gear first" in bad(listener)


def test_one_polarity_that_is_not_captured_is_no(driving) -> None:
    def still(m):
        return m._replace(newest_index=7) if isinstance(m, EdgesInputRise) else m

    listener = heard(rewired(driving, still))
    assert "one polarity" in found(listener)["input sensor"].text
    assert "input sensor" in bad(listener)


def test_a_message_that_is_missing_slow_or_damaged_is_no(driving) -> None:
    sensors = driving[
        [type(Receiver(*Node).receive(f).message) for _, f in driving[:40]].index(GearboxSensors)
    ][1].can_id
    without = [timed for timed in driving if timed[1].can_id != sensors]
    assert "not heard" in found(heard(without))["GearboxSensors"].text
    halved, keep = [], False
    for timed in driving:
        if timed[1].can_id == sensors:
            keep = not keep
        if timed[1].can_id != sensors or keep:
            halved.append(timed)
    assert "50." in found(heard(halved))["GearboxSensors"].text
    assert "GearboxSensors" in bad(heard(halved))
    damaged = [
        (t, f._replace(data=f.data[:-1] + bytes([f.data[-1] ^ 1])) if f.can_id == sensors else f)
        for t, f in driving
    ]
    assert "none good" in found(heard(damaged))["GearboxSensors"].text


def test_a_rate_is_the_bus_s_own_while_bus_time_waits_for_a_busy_machine(driving) -> None:
    listener = heard(driving[: len(driving) // 2])
    silent_s = 2.0
    listener.heard.idle(listener.heard.now_s + silent_s)
    for time_s, frame in driving[len(driving) // 2 :]:
        listener.take(time_s + silent_s, message_of(frame, time_s + silent_s))
    assert found(listener)["GearboxSensors"].text.startswith("100.")
    assert found(listener)["GearboxSensors"].verdict is Verdict.GOOD


def test_a_stall_at_the_end_is_no_silence_where_bus_time_waits(driving) -> None:
    slow = [(100.0 + 8.0 * (t - 100.0), frame) for t, frame in driving[: len(driving) // 8]]
    listener = heard(slow)
    listener.heard.idle(listener.heard.now_s + 0.2)
    assert "GearboxSensors" not in bad(listener)
    assert "channel valid" in found(listener)["GearboxSensors"].text
    listener.heard.idle(listener.heard.now_s + 2.0)  # as long as nothing waits
    assert "GearboxSensors" in bad(listener)


def test_what_is_wrong_with_many_messages_is_said_once(driving) -> None:
    listener = heard(driving)
    listener.heard.idle(listener.heard.now_s + 1.0)
    is_ready, reason = answer(list(listener.findings()))
    assert not is_ready
    assert reason.count("channel invalid") == 1
    assert "EdgesInputRise, EdgesInputFall, " in reason
    assert "EEC1: channel invalid, 80 a second, 100 wanted" in reason


def test_no_air_and_a_dragging_brake_are_no(driving) -> None:
    def change(m):
        if isinstance(m, GearboxSensors):
            return m._replace(supply_pressure_pa=1.1e5, brake_pressure_pa=2.0e5)
        return m

    assert {"supply", "brake pressure"} <= set(bad(heard(rewired(driving, change))))


def test_stamps_that_come_in_bundles_scatter_and_drift_are_reported(driving) -> None:
    bundled = [(round(t * 200) / 200 if i % 7 else t, f) for i, (t, f) in enumerate(driving)]
    assert "bundles" in found(heard(bundled))["arrival"].text
    late = [(t + 0.012 * (int(t * 10) % 2), f) for t, f in driving]
    assert "arrival" in bad(heard(late))
    fast = [(t * 1.001, f) for t, f in driving]
    assert "+1000" in found(heard(fast))["drift"].text
    assert "drift" in bad(heard(fast))
    waiting = [(t * 2.5, f) for t, f in driving]
    assert "runs 0.40 times as fast" in found(heard(waiting))["drift"].text
    assert "drift" in bad(heard(waiting))


@pytest.mark.parametrize(
    ("turned", "verdict"),
    [
        ({Shaft.INPUT: 12}, Verdict.GOOD),
        ({Shaft.INPUT: 12, Shaft.LAYSHAFT: 10}, Verdict.GOOD),  # in mesh by the splitter
        ({Shaft.MAIN: 12}, Verdict.BAD),
        ({}, Verdict.UNKNOWN),
    ],
)
def test_a_shaft_turned_by_hand_must_count_itself(turned, verdict) -> None:
    edges = {shaft: turned.get(shaft, 0) for shaft in Shaft}
    assert judge_turned(Shaft.INPUT, edges).verdict is verdict


def device(**data) -> str:
    info = {
        "ctrlmode": ["FD"], "state": "ERROR-ACTIVE", "berr_counter": {"tx": 0, "rx": 0},
        "restart_ms": 100, "bittiming": {"bitrate": 500000, "sample_point": "0.800"},
        "data_bittiming": {"bitrate": 2000000, "sample_point": "0.800"}, **data,
    }  # fmt: skip
    entry = {
        "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "mtu": 72, "txqlen": 1000,
        "linkinfo": {
            "info_kind": "can", "info_data": info,
            "info_xstats": {"bus_error": data.pop("bus_error", 0), "bus_off": 0},
        },
        "stats64": {"rx": {"dropped": 0}, "tx": {"dropped": 0}},
    }  # fmt: skip
    return json.dumps([{}, {**entry, **{k: v for k, v in data.items() if k in entry}}])


@pytest.mark.parametrize(
    ("change", "subject", "said"),
    [
        ({"mtu": 16}, "CAN FD", "dbitrate 2000000 dsample-point 0.8 fd on.*take one that has it"),
        ({"flags": ["NOARP"]}, "link", "is down"),
        ({"txqlen": 10}, "transmit queue", "txqueuelen 1000"),
        ({"restart_ms": 0}, "restart-ms", "off the bus for ever"),
        ({"state": "BUS-OFF", "restart_ms": 0}, "controller state", "type can restart"),
        ({"state": "ERROR-PASSIVE"}, "controller state", "termination"),
        ({"bittiming": {"bitrate": 250000}}, "bit rate", "500 kbit/s and 2 Mbit/s"),
        (
            {"bittiming": {"bitrate": 500000, "sample_point": 0.5}},
            "sample point", "50.0 %",
        ),
    ],
)  # fmt: skip
def test_each_fact_of_a_link_that_is_wrong_is_the_reason(change, subject, said) -> None:
    assert [f for f in judge_link(link_of(device())) if f.verdict is not Verdict.GOOD] == []
    wrong = [f for f in judge_link(link_of(device(**change))) if f.verdict is Verdict.BAD]
    assert [f.subject for f in wrong] == [subject]
    assert re.search(said, wrong[0].text)


@pytest.mark.parametrize("fd", [False, True])
def test_a_classic_profile_needs_neither_fd_nor_its_bit_rate(fd: bool) -> None:
    reported = device() if fd else device(mtu=16, ctrlmode=[], data_bittiming={})
    findings = list(judge_link(link_of(reported), profile=WireProfile.CLASSIC))
    assert [f for f in findings if f.verdict is not Verdict.GOOD] == []
    slow = device(bittiming={"bitrate": 250000, "sample_point": 0.875})
    wrong = answer(list(judge_link(link_of(slow), profile=WireProfile.CLASSIC)))
    assert not wrong[0]
    assert wrong[1].endswith("the contract has 500 kbit/s")


def test_error_counters_that_grow_while_listening_are_no() -> None:
    before, now = link_of(device()), link_of(device(bus_error=3))
    assert answer(list(judge_link(now, now)))[0]
    assert "bus_error +3" in answer(list(judge_link(now, before)))[1]


def test_a_virtual_device_says_what_cannot_be_known() -> None:
    link = link_of('[{"ifname":"vcan0","flags":["UP"],"mtu":72,"linkinfo":{"info_kind":"vcan"}}]')
    reported = list(judge_link(link))
    assert [f.verdict for f in reported] == [Verdict.GOOD, Verdict.GOOD, Verdict.UNKNOWN]
    assert "error counters" in reported[-1].text


def test_what_is_no_link_is_said() -> None:
    for text in ("", "[]", "[{}]", "no"):
        with pytest.raises(LinkError):
            link_of(text)


def test_a_classic_device_is_refused_at_the_start_and_the_reason_of_the_no(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    (tmp_path / "can9").mkdir()
    (tmp_path / "can9" / "mtu").write_text("16\n")
    monkeypatch.setattr("meshpoint.bus.options._NET_DEVICES", tmp_path)
    monkeypatch.setattr(command, "read_link", lambda _: link_of(device(mtu=16)))
    words = ["-i", "socketcan", "-c", "can9"]
    assert main(["controller", *words]) == 2
    refusal = capsys.readouterr().err
    assert "dbitrate 2000000 dsample-point 0.8 fd on" in refusal
    assert "take one that has it" in refusal
    assert main(["check", *words]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("NOT READY: open: can9 is set up for cla")


def test_over_the_local_bus_with_the_rig_as_the_other_side(
    channel: str, tmp_path: Path, capsys
) -> None:
    words = ["-c", channel, "--gearbox", "truck12", "--json", "-"]
    with live(tmp_path, "rig", "-c", channel, "--gearbox", "truck12", "--seed", "1") as rig:
        rig.until_said("on meshpoint channel")
        code, said, record = 1, "", {"reason": "not looked yet"}

        def is_ready() -> bool:
            """A look of 2 s may fall into a time in which the machine keeps the rig from
            running."""
            nonlocal code, said, record
            code = main(["check", *words, "--seconds", "2", "--turn", "input"])
            printed, said = capsys.readouterr()
            record = json.loads(printed)
            return record["ready"]

        until(is_ready, "a rig that is heard whole")
        assert code == 0, record["reason"]
        by_subject = {f["subject"]: f for f in record["findings"]}
        assert by_subject["bit timing"]["verdict"] == "unknown"
        assert "meshpoint reports no bit rates" in by_subject["bit timing"]["text"]
        assert by_subject["input turned by hand"]["verdict"] == "good"
        assert "turn the input shaft by hand" in said


@pytest.mark.parametrize("profile", ["fd", "classic"])
def test_a_node_is_alive_whose_status_is_heard_and_no_other(
    channel: str, tmp_path: Path, capsys, profile: str
) -> None:
    bus = ["-c", channel, "--profile", profile]
    with live(tmp_path, "rig", *bus, "--gearbox", "truck12") as rig:
        rig.until_said("on meshpoint channel")
        until(lambda: main(["check", "--alive", "rig", *bus]) == 0, "a rig at work")
        assert "READY (" in capsys.readouterr().out
        words = ["check", "--alive", "controller", *bus, "--seconds", "0.3", "--json", "-"]
        assert main(words) == 1
        record = json.loads(capsys.readouterr().out)
    assert record["ready"] is False
    assert record["reason"].startswith("controller: 0 status frames within 0.3 s")


def test_a_dead_bus_is_one_line_that_says_what_was_listened_to(channel: str, capsys) -> None:
    words = ["check", "-c", channel, "--seconds", "0.3", "--turn", "--json", "-"]
    assert main(words) == 1
    printed, asked = capsys.readouterr()
    record = json.loads(printed)
    assert "nothing at all is sent: no frame on meshpoint channel" in record["reason"]
    assert f"{channel} in 0.3 s" in record["reason"]
    bad = [f for f in record["findings"] if f["verdict"] == "bad"]
    assert len(bad) == 1
    assert {f["group"] for f in record["findings"]} == {"interface", "messages"}
    assert "by hand" not in asked
    assert asked.startswith("listening for 0.3 s on meshpoint channel")


def test_a_bus_that_only_repeats_what_is_not_ours_is_no() -> None:
    listener = Listener(SHEET)
    for i in range(50):
        listener.take(i * 0.01, can.Message(arbitration_id=0x123, is_extended_id=False))
    is_ready, reason = answer(list(listener.findings()))
    assert not is_ready
    assert "GearboxSensors, " in reason and reason.count("not heard") == 1
