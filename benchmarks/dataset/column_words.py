"""What each column of the set is: the data sheet's tables are made of these."""

from __future__ import annotations

from typing import Final

SHIFT: Final = "Name of the shift: kind, gearbox, request, how it was fired."
TIME: Final = "When it was sampled: sensor clock, since the request."
ARRIVAL: Final = "When it had reached the controller: sensor clock, since the request."
KIND: Final = "`upshift` or `downshift`, of the main box alone."
SPLIT: Final = "`test`: the gearbox is held out; `train`: all others."
STRATEGY: Final = "`target_phase`: fired to meet a gap; `speed_window`: fired by the slip alone."
SEED: Final = "Seed of the gearbox: shifts of one seed share every part of it."
PITCH: Final = "Angle from dog tooth to dog tooth; a phase repeats after it."
HALF_GAP: Final = "Half a gap beyond the tooth's width, by the data sheet."
PHASE: Final = "Angle of a gear's tooth from the middle of the sleeve's gap, within half a pitch."
SD: Final = "Its standard deviation; 32.77 deg and 327.7 rpm are the most that the bus carries."
EXPECTED_SLIP: Final = "Slip expected there."
SLIP: Final = "Speed of the gear less that of the sleeve."
FILES: Final = {
    "shifts": "A row for each shift: what may be known before it.",
    "edges": "Tooth edges of the four shafts' sensor wheels, each once.",
    "sleeves": "Positions of the four sleeves, each 1 ms.",
    "pressures": "Pressures, oil and clutch, each 10 ms.",
    "valves": "Which valves are driven, each 10 ms.",
    "commands": "What the controller commanded, where that changed.",
    "engine": "What the engine says of itself, each 10 ms.",
    "estimates": "What the controller estimated, each step of some 10 ms.",
    "predictions": "What the controller planned and expected of a contact, each step.",
    "contacts": "The answer: the first contact of sleeve and gear, by the rig's truth.",
    "phase": "True phase of the gear asked for, each 10 ms.",
    "layshaft": "True speed of the layshaft, each 2 ms.",
    "events": "What happened between sleeve and gear, at clutch and brake.",
    "conditions": "What was drawn for the gearbox and its day; nobody on the bus knows it.",
}
"""By the file's name; those of `known` and `later` are alike."""
OF_ALL: Final = {"shift": SHIFT, "time_us": TIME, "arrival_us": ARRIVAL}
OF_FILE: Final[dict[str, dict[str, str]]] = {
    "shifts": {
        "kind": KIND,
        "split": SPLIT,
        "strategy": STRATEGY,
        "gearbox_seed": SEED,
        "from_gear": "Number of the old gear, 1 to 12; 13 and 14 are the crawl gears.",
        "to_gear": "Number of the gear asked for.",
        "pitch_deg": PITCH,
        "half_gap_deg": HALF_GAP,
        "gear_ratio": "Speed of the gear asked for over that of the layshaft.",
        "reference_deg": "Phase of the gear at edge 0 of layshaft and main shaft, as the "
        "controller had learned it by then, its error included.",
        "request_clock_us": "The sensor clock's 32-bit time at the request.",
        "cutoff_us": "End of what is known; the contact is 45,000 us later.",
    },
    "edges": {
        "shaft": "`input`, `layshaft`, `main` or `propeller`.",
        "edge": "`rise`: a tooth begins; `fall`: it ends.",
        "index": "Running number since power-up, rising and falling apart; a rising edge is at "
        "index * 360 / (teeth of the wheel) degrees.",
    },
    "sleeves": {
        "sleeve": "`first_second`, `crawl_third`, `splitter` or `range`.",
        "position_mm": "From neutral; the first-named gear is at the negative end.",
    },
    "pressures": {
        "brake_pressure_bar": "Absolute, between brake valve and layshaft brake.",
        "supply_pressure_bar": "Absolute, of the air supply.",
        "oil_temperature_c": "Of the gearbox's oil (degrees Celsius).",
        "clutch_closed_percent": "0 is open.",
    },
    "valves": {"_on": "Whether the valve is driven."},
    "commands": {
        "valve": "The valve, or `clutch`.",
        "action": "`off_now`, `on_now`, `off_at`, `on_at`; of the clutch `open`, `close`.",
        "switch_us": "When `off_at` and `on_at` take effect: sensor clock, since the request.",
    },
    "engine": {
        "time_us": "When its frame came: sensor clock, since the request.",
        "engine_speed_rpm": "Of the crankshaft.",
        "engine_torque_percent": "Actual torque, of the reference torque.",
    },
    "estimates": {
        "time_us": "When it holds: sensor clock, since the request.",
        "layshaft_speed_rpm": "Of the layshaft.",
        "layshaft_speed_sd_rpm": SD,
        "layshaft_valid": "Whether the estimate may be used.",
        "main_speed_rpm": "Of the main shaft.",
        "main_speed_sd_rpm": SD,
        "main_valid": "Whether the estimate may be used.",
        "slip_rpm": SLIP,
        "phase_deg": PHASE,
        "phase_sd_deg": SD,
        "phase_known": "Whether the gear's phase reference is known.",
        "model_valid": "Clutch open and main box in neutral.",
    },
    "predictions": {
        "time_us": "When it was decided: sensor clock, since the request.",
        "decision": "What was decided; from `committed` on the plan stands.",
        "contact_us": "When the contact is expected: sensor clock, since the request.",
        "phase_deg": "Phase expected there; 0 while none is aimed at.",
        "phase_sd_deg": SD,
        "slip_rpm": EXPECTED_SLIP,
    },
    "contacts": {
        "kind": KIND,
        "split": SPLIT,
        "strategy": STRATEGY,
        "gearbox_seed": SEED,
        "pitch_deg": PITCH,
        "half_gap_deg": HALF_GAP,
        "contact_us": "When sleeve and gear met first: sensor clock, since the request.",
        "contact": "`gap`, or `tooth`: the sleeve met a tooth's face.",
        "phase_deg": "The phase then: what is to be predicted.",
        "slip_rpm": SLIP,
        "attempts": "Times a sleeve was fired; one that is stopped on its way is no other.",
        "aborts": "Times a sleeve was stopped short of the teeth.",
        "result": "How the shift ended.",
        "duration_ms": "From request to outcome.",
    },
    "phase": {
        "phase_deg": PHASE,
        "main_speed_rpm": "Of the main shaft.",
        "road_speed_km_h": "Of the vehicle.",
    },
    "layshaft": {"layshaft_speed_rpm": "By an encoder without error."},
    "events": {
        "time_us": "When it happened: sensor clock, since the request.",
        "event": "What happened.",
        "gear": "At which gear of the main box; `neutral` at clutch and brake.",
        "phase_deg": PHASE,
        "slip_rpm": SLIP,
        "impact_j": "Energy lost in the flanks' impact, with `locked` alone.",
    },
    "conditions": {
        "from_gear": "Number of the old gear.",
        "to_gear": "Number of the gear asked for.",
        "backlash_percent": "Gap beyond the tooth, of a pitch, as built.",
        "gap_share": "Share of all phases that meet a gap in this gearbox.",
        "delay_sd_ms": "Scatter of the sleeve's delay from shift to shift.",
        "oil_c": "Temperature of the oil (degrees Celsius).",
        "slope_percent": "Of the road; above 0: uphill.",
        "mass_kg": "Of the vehicle.",
        "supply_offset_bar": "Supply pressure beside the data sheet's.",
    },
}
"""By file and column; a key that begins with `_` is the end of a column's name."""


def words_of(file: str, column: str) -> str:
    """What a column is. KeyError where nothing says it."""
    of = OF_FILE[file]
    end = next((of[key] for key in of if key.startswith("_") and column.endswith(key)), None)
    return of.get(column) or end or OF_ALL[column]
