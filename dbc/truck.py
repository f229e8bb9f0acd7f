"""The messages of a truck's other nodes, from a DBC of their own: who does not use them does not
see a change in the wire contract, nor in its hash."""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.schema import schema_of
from meshpoint.dbc.source import DBC_PATH

TRUCK_DBC: Final = DBC_PATH.with_name("truck.dbc")
"""Where it is."""
TRUCK_CONTENT: Final = TRUCK_DBC.read_bytes()
TRUCK_SCHEMA: Final = schema_of(TRUCK_DBC)
"""What it says."""
