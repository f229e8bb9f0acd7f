"""Makes python-can know our interfaces when this package is not installed.

Installed, python-can finds them by the entry point `can.interface`, and this changes nothing.
"""

from typing import Final

import can
import can.interfaces
import can.util

INTERFACES: Final = {
    "meshpoint": ("meshpoint.bus.local.plugin", "MeshpointBus"),
    "meshpoint_simulated": ("meshpoint.bus.simulated.plugin", "SimulatedBus"),
}


def register_interface() -> None:
    """Adds the interfaces to python-can's tables; python-can copies them at import."""
    if INTERFACES.keys() <= can.interfaces.BACKENDS.keys():
        return
    can.interfaces.BACKENDS.update(INTERFACES)
    known = frozenset(can.interfaces.BACKENDS)
    for module in (can, can.interfaces, can.util):
        module.VALID_INTERFACES = known  # type: ignore[attr-defined]
