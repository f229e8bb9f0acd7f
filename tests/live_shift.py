"""A shift of a rig (preset `thesis`), 8 to 10, with all nodes in this process."""

from pathlib import Path

import can

from meshpoint.base.version import product_version
from meshpoint.bench.bench import plan_shifts
from meshpoint.bench.live import LiveRun
from meshpoint.bench.simulate import LAYSHAFT_RAD_S
from meshpoint.bus.profile import WireProfile
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.settings import Preset, RigSettings


def one_shift(
    folder: Path, sheet: GearboxSheet, speed: float, wire: WireProfile = WireProfile.FD
) -> LiveRun:
    """Its header and its log are in the folder; speed: bus time over wall time."""
    header = new_header(product_version(), sheet, ControllerSettings(), armed=True)
    header.save(folder)
    (shift,) = plan_shifts(sheet, [(8, 10)], 1, LAYSHAFT_RAD_S)
    return LiveRun(
        header=header,
        rig=RigSettings(preset=Preset.THESIS, seed=1, start_gear=8, main_speed_rpm=shift.main_rpm),
        plan=[shift],
        log=folder / "run.log",
        open_bus=lambda: can.Bus(interface="virtual", channel=str(folder)),
        speed=speed,
        in_process=True,
        wire=wire,
    )
