"""Where a result comes from: what every output carries so that it can be made again."""

from __future__ import annotations

from typing import Any

from meshpoint.dbc import DBC_SHA256
from meshpoint.gearbox import GearboxSheet
from meshpoint.testbench.version import product_version


def provenance(sheet: GearboxSheet, seed: int, preset: str) -> dict[str, Any]:
    """Seed, scenario, contract, data sheet and version."""
    return {
        "seed": seed,
        "preset": preset,
        "gearbox": sheet.name,
        "dbc_sha256": DBC_SHA256,
        "gearbox_sha256": sheet.sha256,
        "version": product_version(),
    }
