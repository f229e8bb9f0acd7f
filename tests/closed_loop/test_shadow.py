"""A controller that only watches, and what a log says of two controllers."""

from __future__ import annotations

import asyncio
import json
from itertools import pairwise
from pathlib import Path

import can
import pytest
from loop_bench import SHEET, Loop

from meshpoint.base.version import product_version
from meshpoint.bus.clock import Clock
from meshpoint.bus.driver import run_node
from meshpoint.bus.frames import message_of
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.bus.options import LISTEN_ONLY, listen_only_words, open_bus_from
from meshpoint.cli.main import main
from meshpoint.cli.table import build_parser
from meshpoint.controller.core.core import OWN_ADDRESS
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import EngagementEvent, ReferenceEngagement, SleevesMain
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.logs.sleeve_contacts import SleeveContacts
from meshpoint.replays.answer import Answer
from meshpoint.replays.shadow import ShadowCore
from meshpoint.rig_sim.settings import Preset, Profile

SHIFTS = 3
FIRST_CONTACT = {EngagementEvent.GAP_CONTACT: "gap", EngagementEvent.TOOTH_CONTACT: "tooth"}


@pytest.fixture(scope="module")
def production() -> Loop:
    """Some shifts of today's strategy, which fires as soon as the slip is inside its window."""
    loop = Loop(shifts=SHIFTS, settings=ControllerSettings(strategy_name="speed_window"), seed=5)
    loop.run(60_000_000)
    return loop


@pytest.fixture
def log(production: Loop, tmp_path: Path) -> Path:
    path = tmp_path / "bus.log"
    with LogWriter(path, flush_every_s=None) as writer:
        for time_us, frame in production.frames:
            writer.write(1000.0 + time_us * 1e-6, frame)
    production.header.save(tmp_path)
    return path


def shadow() -> ShadowCore:
    return ShadowCore(new_header(product_version(), SHEET, ControllerSettings(), None, armed=True))


def test_a_shadow_sends_nothing_and_tells_both_controllers_shifts(production: Loop) -> None:
    core, lines, sent = shadow(), [], []
    for time_us, frame in production.frames:
        if core.next_step_us <= time_us:
            step = core.step(time_us)
            sent += step.frames
            lines += step.events
        core.receive(frame)
    last = core.shutdown(production.frames[-1][0])
    assert sent + last.frames == []
    lines += last.events
    reported = [line for line in lines if line.startswith("shadow 8 -> 10: fired after")]
    assert reported, "its decisions"
    assert any(line.startswith("production 8 -> 10: first contact") for line in lines)
    assert "sent nothing" in lines[-1]
    assert len([s for s in core.shifts if (s.from_gear, s.to_gear) != (12, 8)]) == SHIFTS


@pytest.fixture(scope="module")
def truck() -> Loop:
    """The same in a truck whose sleeves are driven by air, with sensors as they come."""
    settings = ControllerSettings(strategy_name="speed_window")
    loop = Loop(
        shifts=6, settings=settings, seed=9, sheet=load_sheet("truck12"), preset=Preset.TRUCK,
        profile=Profile.TYPICAL,
    )  # fmt: skip
    loop.run(60_000_000)
    return loop


@pytest.mark.parametrize("bench", ["production", "truck"])
def test_the_sleeves_show_what_the_truth_says_of_first_contacts(
    bench: str, request: pytest.FixtureRequest
) -> None:
    """But of teeth that slide off the face within two samples of the sleeve or three, and of a gap
    that throws the sleeve back at once."""
    loop: Loop = request.getfixturevalue(bench)
    receiver, sleeves = Receiver(*Node), SleeveContacts(loop.sheet)
    seen, events = [], []
    for _, frame in loop.frames:
        message = receiver.receive(frame).message
        if isinstance(message, SleevesMain):
            seen += sleeves.take(message)
        elif isinstance(message, ReferenceEngagement):
            events.append((message.event_time_us, message.event))
    brushed = {
        met_us for met_us, met in events for passed_us, passed in events
        if met is EngagementEvent.TOOTH_CONTACT and passed is EngagementEvent.TOOTH_PASSED
        and 0 <= passed_us - met_us < 3_000
    }  # fmt: skip
    at_teeth = [e for e in events if e[1] in {*FIRST_CONTACT, EngagementEvent.TOOTH_PASSED}]
    brushed |= {
        met_us for (met_us, met), (_, then) in pairwise(at_teeth)
        if met is EngagementEvent.GAP_CONTACT and then is EngagementEvent.TOOTH_PASSED
    }  # fmt: skip
    truth = [(at_us, FIRST_CONTACT[event]) for at_us, event in events if event in FIRST_CONTACT]
    assert len(seen) >= loop.shifts
    kinds = {"gap": 0, "tooth": 0}
    for contact in seen:
        at_us, kind = min(truth, key=lambda each: abs(each[0] - contact.time_us))
        assert abs(at_us - contact.time_us) < 3_000
        if at_us in brushed:
            continue
        assert contact.contact == kind
        kinds[kind] += 1
    assert min(kinds.values()) >= 1, "both were there to be told apart"


def test_a_live_shadow_puts_no_frame_on_the_bus(production: Loop) -> None:
    async def run() -> tuple[int, int, list[str]]:
        other = can.Bus("shadow-test", interface="virtual")
        lines: list[str] = []
        stop, core = asyncio.Event(), shadow()
        node = asyncio.ensure_future(
            run_node(
                core,
                lambda: can.Bus("shadow-test", interface="virtual"),
                Clock(1.0),
                on_event=lines.append,
                stop=stop,
                name="controller",
            )
        )
        while not lines:
            for _, frame in production.frames[:200]:
                other.send(message_of(frame))
            await asyncio.sleep(0.05)
            if core.frames:
                stop.set()
                break
        counts = await node
        heard = 0
        while other.recv(0.0) is not None:
            heard += 1
        other.shutdown()
        return heard, counts.frames_sent + counts.frames_refused, lines

    heard, sent, lines = asyncio.run(run())
    assert (heard, sent) == (0, 0)
    assert "sent nothing" in lines[-1]


@pytest.mark.parametrize("interface", sorted(LISTEN_ONLY))
def test_a_shadow_opens_an_adapter_listen_only_where_it_can(interface: str, monkeypatch) -> None:
    opened = {}
    monkeypatch.setattr("meshpoint.bus.options.can.Bus", lambda **given: opened.update(given))
    for words, expected in (["--shadow"], True), ([], False):
        opened.clear()
        line = ["controller", "-i", interface, "-c", "0", *words]
        with pytest.raises(Exception, match="channel_info"):  # of what is no bus
            open_bus_from(build_parser().parse_args(line))
        has = LISTEN_ONLY[interface].items() <= opened.items()
        assert has is expected
    assert "listen-only" in listen_only_words({"interface": interface})


def test_where_it_cannot_it_says_that_the_adapter_acknowledges() -> None:
    socketcan = listen_only_words({"interface": "socketcan", "channel": "can0"})
    assert "ip link set can0 type can listen-only on" in socketcan
    assert "acknowledges frames" in listen_only_words({"interface": "gs_usb"})


@pytest.mark.parametrize("words", [["--arm"], ["--calibration", "box.toml"]])
def test_a_shadow_takes_nothing_that_would_act_or_keep(words, capsys) -> None:
    assert main(["controller", "--shadow", *words]) == 2
    assert "a shadow sends nothing and keeps nothing" in capsys.readouterr().err


@pytest.mark.long
def test_a_report_says_what_another_strategy_would_have_met(log: Path, capsys) -> None:
    assert main(["replay", "--gap-rate", str(log), "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["recorded"]["shifts"] == SHIFTS
    assert found["decided"] >= 1
    low, high = found["ci95"]
    assert low <= found["rate"] <= high
    assert found["rate"] > SHEET.dog.backlash_share, "a sleeve that is fired at random"
    assert "would have met the gap" in found["sentence"]
    assert found["decided"] + sum(found["not_decidable"].values()) == SHIFTS


def test_of_a_controller_that_is_not_ours_only_its_own_contacts_are_reported(
    production: Loop, tmp_path: Path, capsys
) -> None:
    path = tmp_path / "foreign.log"
    with LogWriter(path, flush_every_s=None) as writer:
        for time_us, frame in production.frames:
            if frame.can_id & 0xFF != OWN_ADDRESS:
                writer.write(1000.0 + time_us * 1e-6, frame)
    assert main(["replay", "--gap-rate", str(path), "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rate"] is None
    assert found["recorded"]["shifts"] >= SHIFTS
    assert "not decidable" in found["sentence"]
    assert "no run of our controller" in found["sentence"]


def test_reasons_that_differ_in_a_number_alone_are_reported_as_one() -> None:
    half = "the landing would be known to within {} deg only, of a pitch of 7.50 deg"
    answer = Answer(9, 2, decided=1, expected=0.5, other="x")
    answer.why_not.update([half.format(4.1), half.format(1.9), half.format(12.0), "no reference"])
    assert "of the 1 shift that can be decided" in answer.sentence
    assert answer.sentence.endswith(
        "not decidable: 3 x the landing would be known to within 1.9 to 12.0 deg only, of a pitch "
        "of 7.50 deg; 1 x no reference"
    )
    assert len(answer.to_json()["not_decidable"]) == 4, "each with its number"


def test_the_interval_of_few_shifts_is_wide_and_none_without_any() -> None:
    assert Answer(0, 0).interval is None
    low, high = Answer(10, 2, decided=4, expected=4.0).interval or (0.0, 0.0)
    assert low < 0.6
    assert high > 0.999
