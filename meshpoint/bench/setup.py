"""What a run in virtual time is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from meshpoint.base.provenance import gearbox_words
from meshpoint.base.version import product_version
from meshpoint.bench.adapter import AdapterProfile
from meshpoint.bench.bench import PlannedShift
from meshpoint.bench.schedules import UPSHIFTS, Pairs
from meshpoint.bus.command_keys import CommandKeys
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.simulated.core import QueueOrder
from meshpoint.controller.settings.header import RunHeader, new_header
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.firmware.board import Firmware
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.orders import ScheduledFault
from meshpoint.rig_sim.settings import (
    DEFAULT_PROFILE,
    RETURN_RAMP_S,
    Preset,
    Profile,
    RigSettings,
)


@dataclass(frozen=True)
class Setup:
    """One simulated run."""

    sheet: GearboxSheet
    settings: ControllerSettings
    preset: Preset = Preset.TRUCK
    seed: int = 1
    shifts: int = 20
    pairs: Pairs = UPSHIFTS
    as_built: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[ScheduledFault, ...] = ()
    calibration: Calibration | None = None
    """What the controller starts with."""
    profile: Profile = DEFAULT_PROFILE
    keys: CommandKeys | None = None
    """Commands are proven with these; None: they are not."""
    bus_load: float | None = None
    """The load of the bus, other nodes' traffic included; None: a bus of our own frames, of average
    length."""
    adapter: AdapterProfile | None = None
    """What lies between the controller and the bus; None: nothing."""
    bus_queue: QueueOrder = QueueOrder.FIFO
    """In which order a node's waiting frames leave, where the bus has a load."""
    wire: WireProfile = WireProfile.FD
    truck_nodes: bool = False
    """The rig plays the truck's other nodes too."""
    firmware: Firmware | None = None
    """The board's firmware stands between rig and bus, run in this way; None: it does not."""

    def rig(self, first: PlannedShift, return_ramp_s: float = RETURN_RAMP_S) -> RigSettings:
        """The rig's settings: it stands in the gear, and turns at the speed, that a shift begins
        with. return_ramp_s: as in `RigSettings`."""
        return RigSettings(
            preset=self.preset,
            seed=self.seed,
            start_gear=first.from_,
            main_speed_rpm=first.main_rpm,
            profile=self.profile,
            as_built=self.as_built,
            faults=self.faults,
            return_ramp_s=return_ramp_s,
            truck_nodes=self.truck_nodes,
        )

    @property
    def gearbox_words(self) -> str:
        """Which gearbox it is of, as titles say it."""
        return gearbox_words(self.sheet, self.preset, self.profile, self.as_built)

    @property
    def header(self) -> RunHeader:
        """The controller's run header."""
        return new_header(product_version(), self.sheet, self.settings, self.calibration)
