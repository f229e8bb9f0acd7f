"""How much of a classic bus the profile takes at most: every frame at its longest, all at once."""

from __future__ import annotations

from typing import Final

from meshpoint.bus.classic.edges import A_FRAME
from meshpoint.bus.simulated.contract_traffic import JITTER_NS, STEP_NS, wire_frame
from meshpoint.bus.simulated.frame_bits import (
    INTERMISSION_BITS,
    BitTiming,
    arbitration_key,
    longest,
)
from meshpoint.bus.simulated.response_time import Traffic, load
from meshpoint.dbc.classic.codecs import CLASSIC_SCHEMA
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import RPM, TURN

LIMIT: Final = 0.60
"""Of the bus, so that there is room for other nodes."""
SECOND_NS: Final = 1_000_000_000
EVENTS_NS: Final = {
    "ValveTime": 30_000_000,
    "ShiftPrediction": 200_000_000,
    "ShiftOutcome": SECOND_NS,
    "ReferenceEngagement": 100_000_000,
    "TC1": 50_000_000,
}
"""The time between two of an event on an average over a second with a shift in it, and with all
that a rig says of it. While two activations wait, `ValveTime` comes with every step."""
QUEUES: Final = {
    Node.GEARBOX_IO: "rig",
    Node.ENGINE: "rig",
    Node.REFERENCE: "rig",
    Node.TRANSMISSION_CONTROL: "controller",
    Node.BENCH: "bench",
}
BENCH_ONLY: Final = frozenset({Node.REFERENCE, Node.BENCH})


def most_edges_per_s(sheet: GearboxSheet) -> tuple[float, float]:
    """Rising edges of layshaft and main shaft at the input shaft's highest speed, each by the step
    that turns it fastest."""
    split = max(sheet.splitter.low.ratio, sheet.splitter.high.ratio)
    gears = (sheet.main.crawl, sheet.main.first, sheet.main.second, sheet.main.third)
    layshaft = sheet.limits.input_max_rad_s * split
    main = layshaft * max(gear.ratio for gear in gears)
    wheels = sheet.wheels
    return layshaft * wheels.layshaft.teeth / TURN, main * wheels.main.teeth / TURN


def classic_traffic(sheet: GearboxSheet, timing: BitTiming | None = None) -> list[Traffic]:
    """All messages of the profile by priority, edges at the highest speeds of the data sheet."""
    timing = timing or BitTiming()
    edges = dict(zip(("EdgesLayshaft", "EdgesMain"), most_edges_per_s(sheet), strict=True))
    found = []
    for spec in CLASSIC_SCHEMA.messages:
        period_ns, late_ns = 1000 * spec.cycle_time_us, JITTER_NS
        if spec.name in edges:
            period_ns = round(SECOND_NS * A_FRAME / edges[spec.name])
            late_ns += STEP_NS  # a read's frames come all at once
        elif not spec.is_cyclic:
            event = spec.name.rstrip("0123456789") if spec.is_protected else spec.name
            period_ns = EVENTS_NS[event]
        frame = wire_frame(spec)
        bits_ns = longest(frame).duration_ns(timing) + INTERMISSION_BITS * timing.nominal_ns
        found.append(
            Traffic(
                spec.name, arbitration_key(frame), QUEUES[spec.sender], bits_ns, period_ns, late_ns
            )
        )
    return sorted(found, key=lambda message: message.key)


def worst_load(sheet: GearboxSheet, *, bench: bool = True) -> float:
    """The share of the bus that is taken at most. bench: with what a rig's reference and a bench
    say besides."""
    names = {
        spec.name for spec in CLASSIC_SCHEMA.messages if bench or spec.sender not in BENCH_ONLY
    }
    return load([message for message in classic_traffic(sheet) if message.name in names])


def edge_load(sheet: GearboxSheet) -> float:
    """What of it are edges: that goes with the speed."""
    names = ("EdgesLayshaft", "EdgesMain")
    return load([message for message in classic_traffic(sheet) if message.name in names])


def load_words(sheet: GearboxSheet) -> str:
    """What a command says of the bus it is put on."""
    rpm, most = sheet.limits.input_max_rad_s / RPM, worst_load(sheet)
    words = (
        f"classic profile, 500 kbit/s: our frames take {most:.1%} of the bus at most "
        f"(input shaft at {rpm:g} rpm, every frame at its longest; without bench and reference "
        f"{worst_load(sheet, bench=False):.1%})"
    )
    if most <= LIMIT:
        return words
    share = edge_load(sheet)
    within_rpm = rpm * (1.0 - (most - LIMIT) / share)
    return f"{words}; {LIMIT:.0%} and less up to {within_rpm:.0f} rpm"
