"""The wire contract is what other nodes were built for: held against a copy that is frozen.

`frozen_contract.json` was made once. Who changes the contract on purpose makes it anew, with

    python tests/dbc/test_frozen_contract.py

and says in CHANGELOG what other nodes have to change.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cantools.database
import pytest

from meshpoint.cli.vectors import encoded
from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.e2e import DEFAULT_LIMITS
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.source import DBC_PATH
from meshpoint.dbc.truck import TRUCK_DBC
from meshpoint.rig_sim.shared.valve_drivers import EXPIRY_US, MAX_AHEAD_US, MAX_LATE_US, Valve

FROZEN = Path(__file__).with_name("frozen_contract.json")
DBCS = {"fd": DBC_PATH, "classic": CLASSIC_DBC, "truck": TRUCK_DBC}


def contract(path: Path) -> dict[str, list[Any]]:
    """All that a node needs to read and write the frames: a line a message, and a line a signal."""
    lines: dict[str, list[Any]] = {}
    for message in cantools.database.load_file(path).messages:
        lines[message.name] = [
            f"{message.frame_id:08X}", message.length, message.is_fd, message.cycle_time,
            message.senders,
        ]  # fmt: skip
        for signal in message.signals:
            lines[f"{message.name}.{signal.name}"] = [
                signal.start, signal.length, signal.byte_order, signal.is_signed,
                float(signal.scale), float(signal.offset), signal.minimum, signal.maximum,
                signal.unit, {str(k): str(v) for k, v in (signal.choices or {}).items()},
            ]  # fmt: skip
    return lines


def rules() -> dict[str, Any]:
    """What is not in a DBC."""
    return {
        "e2e_data_ids": {name: codec.spec.data_id for name, codec in CODECS.items()},
        "e2e_limits": vars(DEFAULT_LIMITS),
        "valves": {valve.name: int(valve) for valve in Valve},
        "valve_us": [EXPIRY_US, MAX_LATE_US, MAX_AHEAD_US],
    }


def now() -> dict[str, Any]:
    """The contract as it is today, as JSON gives it back."""
    found = {name: contract(path) for name, path in DBCS.items()} | {"rules": rules()}
    found["vectors"] = {f"{n}: {w}": f.data.hex() for n, w, f in encoded()}
    plain: dict[str, Any] = json.loads(json.dumps(found))
    return plain


@pytest.mark.parametrize("part", ["fd", "classic", "rules", "vectors"])
def test_what_is_on_the_wire_is_what_was_frozen(part: str) -> None:
    was, is_now = json.loads(FROZEN.read_text(encoding="utf-8"))[part], now()[part]
    changed = {k: (was.get(k), is_now.get(k)) for k in was | is_now if was.get(k) != is_now.get(k)}
    assert not changed


if __name__ == "__main__":
    parts = [
        f'"{part}": {{\n'
        + ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in lines.items())
        + "\n}"
        for part, lines in now().items()
    ]
    FROZEN.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")
