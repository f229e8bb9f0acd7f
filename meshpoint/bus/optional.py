"""What a node may have around its core and need not: the rooms of the bus that are loaded where a
run asks for one, and by nobody else on a frame's way (the contract in pyproject.toml)."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from meshpoint.bus.command_keys import CommandKeys
from meshpoint.bus.core import Core
from meshpoint.bus.records import Records
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet


def proven(core: Core, keys: CommandKeys) -> Core:
    """The controller with its commands proven (docs/wire.md). KeysError where the package for it is
    not installed."""
    from meshpoint.bus.authentication.cores import ProvingCore

    return ProvingCore(core, keys)


def verified(core: Core, keys: CommandKeys, random_bits: Callable[[int], int]) -> Core:
    """The rig that takes proven commands alone. KeysError as above. random_bits: draws a whole
    number of this many bits, for challenges."""
    from meshpoint.bus.authentication.cores import VerifyingCore
    from meshpoint.bus.authentication.proof import CHALLENGE_BITS

    return VerifyingCore(core, keys, lambda: random_bits(CHALLENGE_BITS))


def diagnosed(core: Core, version: str, address: int) -> Core:
    """The controller that claims its address, reports trouble codes and answers testers
    (docs/diagnosis.md). address: the controller's on the bus, for what is said of it."""
    from meshpoint.bus.diagnosis.core import DiagnosedCore

    return DiagnosedCore(core, version, reported_as=address)


def classic_controller(core: Core, sheet: GearboxSheet) -> Core:
    """The controller on a bus of frames of 8 bytes (docs/wire.md)."""
    from meshpoint.bus.classic.cores import ClassicControllerCore

    return ClassicControllerCore(core, sheet)


def classic_rig(core: Core, sheet: GearboxSheet, *, has_board: bool = False) -> Core:
    """The rig on such a bus; has_board: the gearbox's node in it speaks classic frames itself."""
    from meshpoint.bus.classic.cores import ClassicRigCore

    return ClassicRigCore(core, sheet, has_board=has_board)


def classic_signs() -> Mapping[int, Callable[[Frame], object]]:
    """The frames by which a controller on such a bus is known, as `controller/run/node.py` has
    them."""
    from meshpoint.dbc.classic.codecs import ClassicEar

    name = "ValveOrders"
    return {ClassicEar(name).can_id: lambda frame: ClassicEar(name).hear(frame).message}


def recorded_steps(core: Core, records: Records, run_hash: int, *, diagnosed: bool) -> Core:
    """A classic controller that leaves, for a replay, which frames each step has used."""
    from meshpoint.bus.classic.step_record import StepRecord

    return StepRecord(core, records, run_hash, diagnosed=diagnosed)
