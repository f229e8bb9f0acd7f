"""What the estimators assume of noise: groups of the settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from meshpoint.gearbox.driveline import Driveline
from meshpoint.gearbox.sheet import SENSOR_SD_PA, GearboxSheet
from meshpoint.gearbox.tables import quantity
from meshpoint.units import DEG, RPM


@dataclass(frozen=True)
class ThesisFilterTuning:
    """Tuning of the thesis's Kalman filter: Q_k = (w dt)(w dt)' (5.8) and R."""

    w_angle_rad_s: float = quantity("w_angle_deg_s", 0.0, 1e4, DEG, default=0.5 * DEG)
    """`w` of the layshaft's angle."""
    w_speed_rad_s2: float = quantity("w_speed_rad_s2", 0.0, 1e5, default=20.0)
    """`w` of its speed."""
    w_pressure_pa_s: float = quantity("w_pressure_bar_s", 0.0, 1e3, 1e5, default=1e5)
    """`w` of the brake pressure."""
    r_angle_rad: float = quantity("r_angle_deg", 1e-4, 5.0, DEG, default=0.02 * DEG)
    """Standard deviation of a measured angle: R is its square."""


@dataclass(frozen=True)
class CruiseFilterTuning:
    """Tuning of the constant-speed filter of main shaft and engaged layshaft."""

    acceleration_rad_s2: float = quantity("acceleration_rad_s2", 0.0, 1e5, default=30.0)
    """Acceleration that the model of constant speed leaves out."""
    edge_time_us: float = quantity("edge_time_us", 0.1, 100.0, default=1.0)
    """Standard deviation of an edge's time."""


@dataclass(frozen=True)
class CrossingFilterTuning:
    """Noises that the crossing-time filter assumes; where they come from: docs/estimation.md."""

    REMOVED: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            ("fuse_input", "fuse_propeller", "mesh_walk_deg", "mesh_side_deg", "mesh_side_ms"),
            "angles come from the layshaft's and the main shaft's own wheels alone; the line may "
            "be deleted",
        ),
        **dict.fromkeys(
            ("far_hz", "far_factor", "far_rpm"),
            "a driveline that swings does so at one frequency; the line may be deleted",
        ),
        **{f"near_{key}": f"its name is swing_{key} now" for key in ("hz", "factor", "rpm")},
    }

    edge_time_s: float = quantity("edge_time_us", 0.1, 200.0, 1e-6, default=10e-6)
    """Standard deviation of an edge's time."""
    tooth_error_rad: float = quantity("tooth_error_deg", 1e-4, 5.0, DEG, default=0.2 * DEG)
    """Standard deviation of an edge's place on a wheel whose teeth have not been learned."""
    gate_sd: float = quantity("gate_sd", 2.0, 100.0, default=5.0)
    """An edge further off than this many standard deviations is refused."""
    torque_disturbance_nm: float = quantity("torque_disturbance_nm", 0.0, 200.0, default=1.0)
    """Standard deviation of torques at the layshaft that the model leaves out."""
    disturbance_s: float = quantity("disturbance_ms", 0.5, 5000.0, 1e-3, default=0.02)
    """How long such a torque lasts."""
    gain_sd: float = quantity("gain_sd_percent", 0.0, 50.0, 0.01, default=0.1)
    """Standard deviation of the brake's torque over that of its sheet, before it has been
    learned."""
    gain_walk: float = quantity("gain_walk_percent", 0.0, 50.0, 0.01, default=0.02)
    """By how much the brake's gain wanders in a second: friction changes with speed and
    temperature."""
    gain_pause: float = quantity("gain_pause_percent", 0.0, 50.0, 0.01, default=0.01)
    """Standard deviation that the pause between two shifts adds to the brake's gain."""
    drag_sd_nm: float = quantity("drag_sd_nm", 0.0, 100.0, default=5.0)
    """Standard deviation of the steady drag, before it has been learned."""
    drag_walk_nm: float = quantity("drag_walk_nm", 0.0, 100.0, default=1.0)
    """By how much the drag wanders in a second."""
    drag_pause_nm: float = quantity("drag_pause_nm", 0.0, 100.0, default=0.5)
    """Standard deviation that the pause between two shifts adds to the drag."""
    pressure_start_sd_pa: float = quantity("pressure_start_sd_bar", 0.0, 5.0, 1e5, default=0.2e5)
    """Standard deviation of the brake pressure when its model begins to hold."""
    pressure_walk_pa: float = quantity("pressure_walk_bar", 0.0, 50.0, 1e5, default=0.5e5)
    """By how much the pressure's model is wrong after a second."""
    follow_rad_s2: float = quantity("follow_rad_s2", 0.1, 1e5, default=60.0)
    """Standard deviation of the acceleration of a layshaft that turns with a gear in mesh."""
    follow_s: float = quantity("follow_ms", 0.5, 5000.0, 1e-3, default=0.01)
    """How long such an acceleration lasts."""
    main_start_rad_s2: float = quantity("main_start_rad_s2", 0.01, 1e4, default=20.0)
    """Standard deviation of the main shaft's steady acceleration when a gear comes out: the vehicle
    on a slope."""
    main_walk_rad_s2: float = quantity("main_walk_rad_s2", 0.0, 1e4, default=5.0)
    """By how much the main shaft's steady acceleration wanders in a second."""
    swing_hz: float = quantity("swing_hz", 1.0, 200.0, default=20.0)
    """Typical frequency at which the main shaft swings against the wheels; the real one is
    learned."""
    swing_factor: float = quantity("swing_factor", 1.01, 4.0, default=1.5)
    """The real one is higher or lower by this factor, one standard deviation."""
    swing_damping: float = quantity("swing_damping_percent", 0.1, 90.0, 0.01, default=0.05)
    """Typical damping of a swing, over the critical one."""
    swing_rad_s: float = quantity("swing_rpm", 0.01, 500.0, RPM, default=10.0 * RPM)
    """Typical speed by which the main shaft swings against the wheels after a gear has come out,
    before any shift has shown it."""
    swing_noise_rad2_s3: float = quantity("swing_noise_rad2_s3", 0.0, 1e6, default=0.1)
    """Typical density of the noise that accelerates the main shaft, before any shift has shown
    it."""
    pressure_sd_pa: float = SENSOR_SD_PA
    """Standard deviation of the measured brake pressure: the data sheet's."""
    lash_rad: float = Driveline().backlash_rad
    """Backlash of the driveline at the propeller shaft: the data sheet's. It is learned."""
    lash_factor: float = Driveline().backlash_factor
    """The real one is larger or smaller by this factor, one standard deviation."""

    def of(self, sheet: GearboxSheet) -> CrossingFilterTuning:
        """These values with the data sheet's own filled in."""
        return dataclasses.replace(
            self,
            pressure_sd_pa=sheet.air.sensor_sd_pa,
            lash_rad=sheet.driveline.backlash_rad,
            lash_factor=sheet.driveline.backlash_factor,
        )
