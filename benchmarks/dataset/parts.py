"""One shift in the parts of the set: what was known 45 ms before contact, what came later, truth.

A part is an Arrow table for each of its files. `known` and `later` together are all that sensors,
valves and controller sent in the shift's window; no row is in both.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import pyarrow as pa

from benchmarks.dataset.plan import AHEAD_US
from benchmarks.dataset.recording import Recorded
from benchmarks.dataset.reference import reference_deg
from benchmarks.dataset.shift_series import VALVES, Columns, ShiftSeries, clock_of
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import DEG

TEXT: Final = pa.dictionary(pa.int32(), pa.string())
TIME, REAL, EXACT, FLAG = pa.int32(), pa.float32(), pa.float64(), pa.bool_()
TIMES: Final = {"time_us": TIME, "arrival_us": TIME}
SERIES: Final[dict[str, dict[str, pa.DataType]]] = {
    "edges": {"shaft": TEXT, "edge": TEXT, "index": pa.int32(), **TIMES},
    "sleeves": {"sleeve": TEXT, **TIMES, "position_mm": REAL},
    "pressures": {
        **TIMES, "brake_pressure_bar": REAL, "supply_pressure_bar": REAL,
        "oil_temperature_c": REAL, "clutch_closed_percent": REAL,
    },
    "valves": {**TIMES, **{f"{valve}_on": FLAG for valve in VALVES}},
    "commands": {"arrival_us": TIME, "valve": TEXT, "action": TEXT, "switch_us": TIME},
    "engine": {**TIMES, "engine_speed_rpm": REAL, "engine_torque_percent": REAL},
    "estimates": {
        **TIMES, "layshaft_speed_rpm": REAL, "layshaft_speed_sd_rpm": REAL, "layshaft_valid": FLAG,
        "main_speed_rpm": REAL, "main_speed_sd_rpm": REAL, "main_valid": FLAG, "slip_rpm": REAL,
        "phase_deg": REAL, "phase_sd_deg": REAL, "phase_known": FLAG, "model_valid": FLAG,
    },
    "predictions": {
        **TIMES, "decision": TEXT, "contact_us": TIME, "phase_deg": EXACT, "phase_sd_deg": REAL,
        "slip_rpm": REAL,
    },
}  # fmt: skip
"""Files of `known` and of `later`: their columns behind `shift`."""
TRUTH: Final[dict[str, dict[str, pa.DataType]]] = {
    "phase": {
        "time_us": TIME, "phase_deg": EXACT, "main_speed_rpm": REAL, "road_speed_km_h": REAL,
    },
    "layshaft": {"time_us": TIME, "layshaft_speed_rpm": REAL},
    "events": {
        "time_us": TIME, "event": TEXT, "gear": TEXT, "phase_deg": EXACT, "slip_rpm": REAL,
        "impact_j": REAL,
    },
}  # fmt: skip
"""Series among the files of `truth`."""
TIME_OF: Final = {"commands": "arrival_us"}
"""What a table's rows are in the order of, where it is not `time_us`."""


class ShiftParts(NamedTuple):
    """All of one shift. Every table begins with the column `shift`."""

    known: dict[str, pa.Table]
    later: dict[str, pa.Table]
    truth: dict[str, pa.Table]
    shift: dict[str, Any]
    """Its row of `shifts.parquet`: what may be known."""
    contact: dict[str, Any]
    """Its row of `truth/contacts.parquet`."""
    conditions: dict[str, Any]
    """Its row of `truth/conditions.parquet`."""


def parts_of(recorded: Recorded, sheet: GearboxSheet) -> ShiftParts:
    """Takes a recorded shift apart. NoReferenceError where its phase cannot be read off edges."""
    clock, row = clock_of(recorded), recorded.row
    series = ShiftSeries(recorded, clock).tables
    contact_us = clock.stamped_us(row.contact_us or 0)
    cutoff_us = contact_us - AHEAD_US
    known = {name: _where(series.get(name, {}), cutoff_us, is_known=True) for name in SERIES}
    later = {name: _where(series.get(name, {}), cutoff_us, is_known=False) for name in SERIES}
    shift_id, key = recorded.shift_id, _key(recorded)
    of_all = {
        "pitch_deg": sheet.dog.pitch_rad / DEG,
        "half_gap_deg": sheet.dog.backlash_rad / DEG / 2,
    }
    gears = {"from_gear": row.from_, "to_gear": row.to}
    ratio = sheet.main_mesh(DRIVE_GEARS[row.to].main).ratio
    return ShiftParts(
        {name: _table(shift_id, of, SERIES[name], name) for name, of in known.items()},
        {name: _table(shift_id, of, SERIES[name], name) for name, of in later.items()},
        {
            name: _table(shift_id, series.get(f"true_{name}", {}), columns, name)
            for name, columns in TRUTH.items()
        },
        key | gears | of_all | {
            "gear_ratio": ratio, "reference_deg": reference_deg(known, sheet, row.to),
            "request_clock_us": row.request_us, "cutoff_us": cutoff_us,
        },
        key | of_all | _contact(recorded, contact_us, series["true_events"]),
        {"shift": shift_id} | gears | recorded.conditions,
    )  # fmt: skip


def _key(recorded: Recorded) -> dict[str, Any]:
    return {
        "shift": recorded.shift_id,
        "kind": recorded.gearbox.kind,
        "split": recorded.gearbox.split,
        "strategy": recorded.strategy,
        "gearbox_seed": recorded.gearbox.seed,
    }


def _contact(recorded: Recorded, contact_us: int, events: Columns) -> dict[str, Any]:
    """The first contact as the rig sent it in `ReferenceEngagement`."""
    row = recorded.row
    gear = DRIVE_GEARS[row.to].main.name.lower()
    named = list(zip(events["time_us"], events["gear"], events["event"], strict=True))
    number = named.index((contact_us, gear, f"{row.contact}_contact"))
    return {
        "contact_us": contact_us,
        "contact": row.contact,
        "phase_deg": events["phase_deg"][number],
        "slip_rpm": events["slip_rpm"][number],
        "attempts": row.attempts,
        "aborts": row.aborts,
        "result": row.result,
        "duration_ms": row.duration_ms,
    }


def _where(columns: Columns, cutoff_us: int, *, is_known: bool) -> Columns:
    """The rows that had arrived by the cutoff, or the others."""
    chosen = [
        number
        for number, arrival_us in enumerate(columns.get("arrival_us", []))
        if (arrival_us <= cutoff_us) == is_known
    ]
    return {name: [of[number] for number in chosen] for name, of in columns.items()}


def _table(shift_id: str, columns: Columns, types: dict[str, pa.DataType], name: str) -> pa.Table:
    """The columns in their types, by time; a table without rows has all of its columns."""
    arrays = {each: pa.array(columns.get(each, []), kind) for each, kind in types.items()}
    rows = len(next(iter(arrays.values())))
    shift = pa.array([shift_id] * rows, pa.string()).cast(TEXT)
    table = pa.table({"shift": shift, **arrays})
    texts = [each for each, kind in types.items() if kind == TEXT]
    order = [(each, "ascending") for each in texts if name in ("edges", "sleeves")]
    return _sorted(table, [*order, (TIME_OF.get(name, "time_us"), "ascending")])


def _sorted(table: pa.Table, order: list[tuple[str, str]]) -> pa.Table:
    """In this order; rows that are equal in it stay as they came."""
    columns = {f"k{number}": _plain(table[name]) for number, (name, _) in enumerate(order)}
    rows = pa.array(range(table.num_rows), pa.int64())
    keys = pa.table({**columns, "row": rows})
    by = [*((name, "ascending") for name in columns), ("row", "ascending")]
    return table.take(keys.sort_by(by)["row"])


def _plain(column: pa.ChunkedArray) -> pa.ChunkedArray:
    return column.cast(pa.string()) if pa.types.is_dictionary(column.type) else column
