"""Where a result comes from: what every output carries so that it can be made again."""

from __future__ import annotations

from collections.abc import Sized
from typing import Any

from meshpoint.base.version import product_version
from meshpoint.dbc import DBC_SHA256
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.settings import Preset, Profile


def provenance(
    sheet: GearboxSheet, seed: int, preset: str, profile: Profile | None
) -> dict[str, Any]:
    """Seed, scenario, contract, data sheet and version; profile: of the preset truck."""
    return {
        "seed": seed,
        "preset": preset,
        "profile": profile if preset != Preset.THESIS else None,
        "gearbox": sheet.name,
        "dbc_sha256": DBC_SHA256,
        "gearbox_sha256": sheet.sha256,
        "version": product_version(),
    }


def gearbox_words(
    sheet: GearboxSheet, preset: Preset, profile: Profile, as_built: Sized = ()
) -> str:
    """Which gearbox a result is of, as titles say it. as_built: the values that were fixed."""
    if preset is Preset.THESIS:
        return f"sheet {sheet.name}, preset thesis"
    values = "value" if len(as_built) == 1 else "values"
    fixed = f", {len(as_built)} as-built {values} overridden" if as_built else ""
    return f"sheet {sheet.name}, profile {profile}{fixed}"
