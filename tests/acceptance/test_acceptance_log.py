"""The log of a run, read by other tools alone."""

from __future__ import annotations

import hashlib
import itertools
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import pytest
from acceptance_kit import HALF_BACKLASH_DEG, MAIN_GEAR_OF
from acceptance_wire import CANDUMP_LINE, Frame, Recorded, Wire, us_between

GAP_CONTACT, TOOTH_CONTACT, LOCKED = 1, 2, 4
ENGAGED = 1

BETWEEN_SHIFTS_MS = 100.0


def decoded(recorded: Recorded, wire: Wire, name: str) -> list[dict[str, Any]]:
    wanted = wire.ids[name]
    return [wire.decode(frame) for frame in recorded.frames if frame.can_id == wanted]


def by_identifier(frames: list[Frame]) -> dict[int, list[Frame]]:
    grouped: dict[int, list[Frame]] = defaultdict(list)
    for frame in frames:
        grouped[frame.can_id].append(frame)
    return grouped


def on_their_cycle(times: list[float], cycle_s: float) -> tuple[list[float], int]:
    """Times without those between two of the cycle, and how many these are: once a second a step
    comes between two, so that it is there when a read arrives (docs/wire.md)."""
    kept = times[:1]
    for time in times[1:]:
        if time - kept[-1] > 0.75 * cycle_s:
            kept.append(time)
    return kept, len(times) - len(kept)


def test_the_log_is_candump_text(recorded: Recorded) -> None:
    lines = recorded.log.read_text().splitlines()
    assert len(lines) == len(recorded.frames) > 1000
    for line in lines:
        assert CANDUMP_LINE.match(line), line


def test_log_times_never_run_backwards(recorded: Recorded) -> None:
    times = [frame.time_s for frame in recorded.frames]
    assert times == sorted(times)


def test_every_frame_is_one_of_the_contract_and_decodes(recorded: Recorded, wire: Wire) -> None:
    for frame in recorded.frames:
        assert frame.can_id in wire.messages, f"{frame.can_id:08X} is not in the DBC"
        message = wire.messages[frame.can_id]
        assert frame.is_extended
        assert len(frame.data) == message.length
        own = wire.data_id(frame.can_id) is not None
        assert frame.is_fd == own, f"{message.name}: own frames are FD, the J1939 ones classic"
        values = wire.decode(frame)
        for signal in message.signals:
            value = values[signal.name]
            if own and signal.minimum is not None:
                assert signal.minimum <= value <= signal.maximum, (message.name, signal.name)


def test_every_message_of_the_contract_that_is_cyclic_is_on_the_bus(
    recorded: Recorded, wire: Wire
) -> None:
    seen = {wire.name(frame.can_id) for frame in recorded.frames}
    cyclic = {message.name for message in wire.messages.values() if message.cycle_time}
    # The bench sends while it has something to say; an upshift asks nothing of the engine.
    assert cyclic - seen <= {"BenchCommand", "TSC1"}, f"never sent: {sorted(cyclic - seen)}"
    assert {"TC1", "BenchCommand", "ShiftOutcome", "ReferenceEngagement"} <= seen


def test_own_frames_carry_a_good_crc_and_a_counter_that_runs_by_one(
    recorded: Recorded, wire: Wire
) -> None:
    for can_id, frames in by_identifier(recorded.frames).items():
        if wire.data_id(can_id) is None:
            continue
        assert all(wire.crc_holds(frame) for frame in frames), wire.name(can_id)
        counters = [frame.data[2] for frame in frames]
        steps = {(b - a) % 256 for a, b in itertools.pairwise(counters)}
        assert steps <= {1}, f"{wire.name(can_id)}: {steps}"


def test_cyclic_messages_keep_the_cycle_time_of_the_contract(
    recorded: Recorded, wire: Wire
) -> None:
    for can_id, frames in by_identifier(recorded.frames).items():
        cycle_ms = wire.messages[can_id].cycle_time
        if not cycle_ms or wire.name(can_id) == "BenchCommand":
            continue  # the bench sends while it has something to say
        times, between = on_their_cycle([frame.time_s for frame in frames], cycle_ms / 1e3)
        assert between <= times[-1] - times[0] + 2.0, wire.name(can_id)
        gaps_ms = [(b - a) * 1e3 for a, b in itertools.pairwise(times)]
        if wire.name(can_id) == "TSC1":  # only while the engine is asked for something
            gaps_ms = [gap_ms for gap_ms in gaps_ms if gap_ms < BETWEEN_SHIFTS_MS]
        mean_ms = sum(gaps_ms) / len(gaps_ms)
        assert mean_ms == pytest.approx(cycle_ms, rel=0.02), wire.name(can_id)
        assert max(gaps_ms) <= 1.5 * cycle_ms, wire.name(can_id)


def test_j1939_frames_tell_the_gears(recorded: Recorded, wire: Wire) -> None:
    gears = {one["CurrentGear"] for one in decoded(recorded, wire, "ETC2")}
    for row in recorded.report["shifts"]:
        assert {row["from"], row["to"]} <= gears
    asked = {one["RequestedGear"] for one in decoded(recorded, wire, "TC1")}
    assert {row["to"] for row in recorded.report["shifts"]} <= asked


def test_steps_are_numbered_and_each_tells_of_the_one_before(
    recorded: Recorded, wire: Wire
) -> None:
    status = decoded(recorded, wire, "ControllerStatus")
    for before, after in itertools.pairwise(status):
        assert after["StepNumber"] == before["StepNumber"] + 1
        assert after["PreviousStepTime"] == before["StepTime"] < after["StepTime"]
        assert after["PreviousConsumedCount"] == before["ConsumedCount"]
        assert after["PreviousConsumedCrc"] == before["ConsumedCrc"]


def test_every_frame_of_the_others_is_consumed_by_one_step(recorded: Recorded, wire: Wire) -> None:
    consumed = others = waiting = 0
    for frame in recorded.frames:
        if wire.sender(frame.can_id) != "TransmissionControl":
            others += 1
            waiting += 1
        elif wire.name(frame.can_id) == "ControllerStatus":
            consumed += wire.decode(frame)["ConsumedCount"]
            waiting = 0
    # Those logged after the last step, and those under way at it, are nobody's yet.
    assert others - waiting - 40 <= consumed <= others


def test_the_run_hash_is_that_of_the_header_beside_the_log(recorded: Recorded, wire: Wire) -> None:
    reported = decoded(recorded, wire, "ControllerStatus")
    hashes = {int(one["RunHashHigh"]) << 32 | int(one["RunHashLow"]) for one in reported}
    assert len(hashes) == 1
    beside = [path for path in recorded.log.parent.iterdir() if path != recorded.log]
    assert beside, "no run header was saved beside the log"
    found = {
        int.from_bytes(hashlib.sha256(path.read_bytes()).digest()[:8], "little") for path in beside
    }
    assert hashes & found, f"none of {[path.name for path in beside]} has the hash of the frames"


def test_nothing_went_wrong_on_a_clean_bus(recorded: Recorded, wire: Wire) -> None:
    last = decoded(recorded, wire, "ControllerStatus")[-1]
    for name in ("E2eErrors", "FormatErrors", "ForeignFrames", "ActiveFault", "InvalidChannels"):
        assert last[name] == 0, name
    valves = decoded(recorded, wire, "ValveStatus")[-1]
    assert valves["RefusedCount"] == 0
    assert valves["ExpiredCount"] == 0


def test_the_rows_are_what_the_reference_saw(recorded: Recorded, wire: Wire) -> None:
    outcomes = [one for one in decoded(recorded, wire, "ShiftOutcome") if one["Result"] == ENGAGED]
    assert len(outcomes) == len(recorded.report["shifts"])
    events = decoded(recorded, wire, "ReferenceEngagement")
    for row, outcome in zip(recorded.report["shifts"], outcomes, strict=True):
        assert (row["from"], row["to"]) == (outcome["FromGear"], outcome["ToGear"])
        assert row["attempts"] == outcome["Attempts"]
        assert row["reference"] == ("unknown", "known")[outcome["Reference"]]
        contacts = [
            event
            for event in events
            if event["Event"] in (GAP_CONTACT, TOOTH_CONTACT)
            and event["Gear"] == MAIN_GEAR_OF[row["to"]]
            and us_between(outcome["RequestTime"], event["EventTime"]) > 0
            and us_between(event["EventTime"], outcome["EndTime"]) > 0
        ]
        assert len(contacts) == row["attempts"]
        if row["attempts"] == 1:
            contact = contacts[0]
            assert row["contact"] == ("gap" if contact["Event"] == GAP_CONTACT else "tooth")
            assert row["phase_error_deg"] == pytest.approx(contact["Phase"], abs=2e-4)
            assert row["slip_rpm"] == pytest.approx(contact["Slip"], abs=2e-3)
            delay_ms = us_between(outcome["FireTime"], contact["EventTime"]) / 1e3
            assert 40.0 <= delay_ms <= 50.0
        lasted_ms = us_between(outcome["RequestTime"], outcome["EndTime"]) / 1e3
        assert row["duration_ms"] == pytest.approx(lasted_ms, abs=30.0)


def test_the_first_engagement_of_a_gear_acts_as_speed_window(
    recorded: Recorded, wire: Wire
) -> None:
    engaged: set[int] = set()
    for outcome in decoded(recorded, wire, "ShiftOutcome"):
        gear = MAIN_GEAR_OF[outcome["ToGear"]]
        assert outcome["Reference"] == (gear in engaged)
        assert outcome["Strategy"] == (2 if gear in engaged else 0)
        engaged.add(gear)


def test_the_phase_is_unknown_in_every_plan_before_the_first_engagement(
    recorded: Recorded, wire: Wire
) -> None:
    first_end = next(
        index
        for index, frame in enumerate(recorded.frames)
        if wire.name(frame.can_id) == "ShiftOutcome"
    )
    for frame in recorded.frames[:first_end]:
        if wire.name(frame.can_id) == "ShiftPrediction":
            assert wire.decode(frame)["Phase"] == 0.0


def test_contact_is_gap_or_tooth_by_the_backlash_and_locks_at_the_flank_of_the_slip(
    recorded: Recorded, wire: Wire
) -> None:
    locked = 0
    for event in decoded(recorded, wire, "ReferenceEngagement"):
        if event["Event"] == GAP_CONTACT:
            assert abs(event["Phase"]) < HALF_BACKLASH_DEG
        elif event["Event"] == TOOTH_CONTACT:
            assert HALF_BACKLASH_DEG <= abs(event["Phase"]) <= 3.75001
        elif event["Event"] == LOCKED:
            locked += 1
            flank = HALF_BACKLASH_DEG if event["Slip"] > 0 else -HALF_BACKLASH_DEG
            assert event["Phase"] == pytest.approx(flank, abs=1e-4)
    assert locked >= len(recorded.report["shifts"])


def test_sleeve_valves_are_off_once_the_gear_is_engaged(recorded: Recorded, wire: Wire) -> None:
    settled = 0
    for frame in recorded.frames:
        name = wire.name(frame.can_id)
        if name == "ControllerStatus":
            settled = settled + 1 if wire.decode(frame)["State"] == 1 else 0
        elif name == "ValveCommand" and settled >= 5:
            values = wire.decode(frame)
            on = [key for key, value in values.items() if key.endswith("Action") and value & 1]
            assert not on, on


def test_the_two_valves_of_a_sleeve_are_never_on_together(recorded: Recorded, wire: Wire) -> None:
    pairs = [("MainFirst", "MainSecond"), ("MainCrawl", "MainThird"), ("SplitLow", "SplitHigh")]
    for status in decoded(recorded, wire, "ValveStatus"):
        for one, other in pairs:
            assert not (status[f"{one}Energised"] and status[f"{other}Energised"])


def test_no_angle_jumps_not_even_between_the_shifts(recorded: Recorded, wire: Wire) -> None:
    whole_deg = 256 * 360.0
    samples: list[tuple[float, float]] = []
    for one in decoded(recorded, wire, "ReferenceEncoder"):
        samples += [(one[f"Angle{i:02}"], one[f"Speed{i:02}"]) for i in range(4, -1, -1)]
    first_valid = 5  # samples from before power-up are no samples
    moves = list(zip(samples[first_valid:], samples[first_valid + 1 :], strict=False))
    for (angle, speed), (next_angle, next_speed) in moves:
        turned = (next_angle - angle + whole_deg / 2) % whole_deg - whole_deg / 2
        assert turned == pytest.approx((speed + next_speed) / 2 * 6.0 * 0.002, abs=0.7)


@pytest.mark.parametrize("shaft", ["Input", "Layshaft", "Main", "Propeller"])
def test_tooth_counters_run_on_through_the_whole_log(
    recorded: Recorded, wire: Wire, shaft: str
) -> None:
    for polarity in ("Rise", "Fall"):
        frames = decoded(recorded, wire, f"Edges{shaft}{polarity}")
        for before, after in itertools.pairwise(frames):
            assert us_between(before["ReadTime"], after["ReadTime"]) == 10_000
            assert (after["NewestIndex"] - before["NewestIndex"]) % 65536 <= 20
            assert not after["Stopped"]
        turned = sum(
            (b["NewestIndex"] - a["NewestIndex"]) % 65536 for a, b in itertools.pairwise(frames)
        )
        assert turned > 500


def test_every_angle_at_start_is_drawn_from_the_seed(
    recorded: Recorded, simulated: Callable[..., Recorded], wire: Wire
) -> None:
    other = simulated("--seed", 2, "--shifts", 3, "--strategy", "target_phase")
    here, there = (decoded(run, wire, "ReferencePhase")[0] for run in (recorded, other))
    for name in ("MainAngle", "PhaseCrawl", "PhaseSecond", "PhaseThird"):
        assert abs(here[name] - there[name]) > 1e-3, name
    here, there = (decoded(run, wire, "ReferenceEncoder")[0] for run in (recorded, other))
    assert abs(here["Angle00"] - there["Angle00"]) > 1e-3


def test_the_sensor_clock_wraps_in_a_run(simulated: Callable[..., Recorded], wire: Wire) -> None:
    # design.md: runs start near the wrap in tests.
    wraps = 0
    for seed in (1, 2):
        run = simulated("--seed", seed, "--shifts", 3, "--strategy", "target_phase")
        times = [one["SampleTime"] for one in decoded(run, wire, "ValveStatus")]
        wraps += sum(b < a for a, b in itertools.pairwise(times))
    assert wraps >= 1
