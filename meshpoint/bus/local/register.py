"""Makes python-can know the interface `meshpoint` when this package is not installed.

Installed, python-can finds it by the entry point `can.interface`, and this changes nothing.
"""

import can
import can.interfaces
import can.util

NAME = "meshpoint"


def register_interface() -> None:
    """Adds the interface to python-can's tables; python-can copies them at import."""
    if NAME in can.interfaces.BACKENDS:
        return
    can.interfaces.BACKENDS[NAME] = ("meshpoint.bus.local.plugin", "MeshpointBus")
    known = frozenset(can.interfaces.BACKENDS)
    for module in (can, can.interfaces, can.util):
        module.VALID_INTERFACES = known  # type: ignore[attr-defined]
