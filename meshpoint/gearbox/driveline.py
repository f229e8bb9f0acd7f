"""What is in front of and behind a gearbox: the tables of a data sheet that say what twists and
turns there, with tolerances."""

from __future__ import annotations

from dataclasses import dataclass

from meshpoint.gearbox.tables import TableError, quantity
from meshpoint.units import DEG, MS


@dataclass(frozen=True)
class Driveline:
    """Propeller shaft, final drive and half-shafts, behind the gearbox."""

    backlash_rad: float = quantity("backlash_deg", 1e-3, 45.0, DEG, default=2.0 * DEG)
    """Backlash from the gearbox to the wheels, felt at the propeller shaft, whole width."""
    backlash_tolerance_rad: float = quantity(
        "backlash_tolerance_deg", 1e-3, 45.0, DEG, default=2.0 * DEG
    )
    """By how much that may be more, from axle to axle and with wear."""
    stiffness_nm_rad: float = quantity("stiffness_nm_rad", 0.0, 1e6, default=0.0)
    """Propeller shaft, half-shafts and tyres in series, felt at the propeller shaft; 0: the sheet
    does not say, and they are taken for rigid."""
    stiffness_tolerance: float = quantity(
        "stiffness_tolerance_percent", 0.1, 90.0, 0.01, default=0.3
    )
    """By how much that may differ, from truck to truck and with the tyres' pressure and load."""
    road_m_rad: float = quantity("road_m_rad", 0.01, 2.0, default=0.2)
    """Rolling radius over the final drive's ratio: the way for a radian of the propeller shaft."""
    vehicle_least_kg: float = quantity("vehicle_least_kg", 500.0, 2e5, default=8e3)
    """The lightest vehicle, unladen and without a trailer."""
    vehicle_most_kg: float = quantity("vehicle_most_kg", 500.0, 2e5, default=44e3)
    """The heaviest."""

    def __post_init__(self) -> None:
        if self.vehicle_least_kg > self.vehicle_most_kg:
            raise TableError(
                f"vehicle_least_kg = {self.vehicle_least_kg:g}, allowed is no more than "
                f"vehicle_most_kg = {self.vehicle_most_kg:g}"
            )

    @property
    def vehicle_kgm2(self) -> tuple[float, float]:
        """Inertia of the lightest and of the heaviest vehicle at the propeller shaft."""
        square = self.road_m_rad**2
        return square * self.vehicle_least_kg, square * self.vehicle_most_kg

    @property
    def backlash_factor(self) -> float:
        """The largest backlash of the tolerance over the sheet's."""
        return (self.backlash_rad + self.backlash_tolerance_rad) / self.backlash_rad


@dataclass(frozen=True)
class Axle:
    """What turns behind a gearbox in neutral: main shaft, propeller shaft, driven wheels on their
    tyres. All but the main shaft's inertia is felt at the propeller shaft."""

    main_kgm2: float = quantity("main_inertia_kgm2", 0.01, 5.0, default=0.25)
    """Main shaft with its sleeves, at the main shaft."""
    propeller_kgm2: float = quantity("propeller_inertia_kgm2", 0.01, 10.0, default=0.5)
    """Propeller shaft and pinion."""
    shaft_nm_rad: float = quantity("shaft_nm_rad", 1e3, 1e6, default=20e3)
    """Stiffness of propeller shaft and half-shafts."""
    shaft_tolerance: float = quantity("shaft_tolerance_percent", 0.1, 90.0, 0.01, default=0.3)
    """By how much the stiffness of the shafts may differ."""
    flank_loss_s_rad: float = quantity("flank_loss_s_rad", 0.01, 10.0, default=0.3)
    """Loss at the flanks of the final drive over their torque and speed (Hunt and Crossley 1975): a
    blow at 1 rad/s loses about two thirds of it."""
    flank_loss_factor: float = quantity("flank_loss_factor", 1.1, 10.0, default=2.0)
    """The loss at the flanks may be this many times as large or small."""
    wheels_kgm2: float = quantity("wheels_inertia_kgm2", 0.1, 200.0, default=16.0)
    """Driven wheels and final drive."""
    tyre_nm_rad: float = quantity("tyre_nm_rad", 1e3, 1e6, default=90e3)
    """Stiffness of the tyres."""
    tyre_tolerance: float = quantity("tyre_tolerance_percent", 0.1, 90.0, 0.01, default=0.4)
    """By how much the stiffness of the tyres may differ."""
    tyre_nms: float = quantity("tyre_nms", 0.0, 1e3, default=60.0)
    """Damping of the tyres' carcass."""
    relaxation_rad: float = quantity("relaxation_rad", 0.1, 100.0, default=3.4)
    """Turn of the propeller shaft after which a rolling tyre's twist has faded to 1/e."""
    pinion_nm: float = quantity("pinion_nm", 0.0, 100.0, default=5.0)
    """Drag of the axle's pinion, in front of the backlash."""
    pinion_tolerance: float = quantity("pinion_tolerance_percent", 1.0, 100.0, 0.01, default=0.8)
    """By how much the pinion's drag may differ."""
    loose_nm: float = quantity("loose_nm", 0.0, 50.0, default=2.0)
    """Drag of the loose gears' bearings on the main shaft, at the main shaft."""
    vehicle_start_rad_s: float = quantity("vehicle_start_rad_s", 0.01, 10.0, default=0.3)
    """Standard deviation of the vehicle's speed at the main shaft as known from the shafts in gear,
    beside what their swing hides."""
    wheels_start_rad_s: float = quantity("wheels_start_rad_s", 0.01, 10.0, default=0.15)
    """Standard deviation of the wheels' speed against the vehicle's, at the main shaft."""
    vehicle_rad_s2: float = quantity("vehicle_rad_s2", 0.01, 20.0, default=1.0)
    """Standard deviation of the vehicle's acceleration, by hills."""
    main_chance_nm: float = quantity("main_chance_nm", 0.0, 50.0, default=0.4)
    """Standard deviation of chance torques on the main shaft: oil, meshes, seals."""
    propeller_chance_nm: float = quantity("propeller_chance_nm", 0.0, 200.0, default=2.0)
    """Standard deviation of chance torques on the propeller shaft."""
    chance_s: float = quantity("chance_ms", 1.0, 1e4, MS, default=50.0 * MS)
    """How long a chance torque lasts."""
    road_chance_nm: float = quantity("road_chance_nm", 0.0, 1e3, default=25.0)
    """Standard deviation of an uneven road's torque on the driven wheels: some hundredths of the
    rolling resistance."""
    road_chance_s: float = quantity("road_chance_ms", 1.0, 1e4, MS, default=80.0 * MS)
    """How long a torque of the road lasts: for as long as a wheel takes over a bump."""


@dataclass(frozen=True)
class Engine:
    """The engine in front of the clutch."""

    inertia_kgm2: float = quantity("inertia_kgm2", 0.05, 50.0, default=3.0)
    """With flywheel and clutch cover."""
    inertia_tolerance: float = quantity("inertia_tolerance_percent", 0.1, 90.0, 0.01, default=0.1)
    """By how much that may differ, from engine to engine."""
    reference_nm: float = quantity("reference_nm", 50.0, 2e4, default=2500.0)
    """The torque that the percentages of EEC1 and TSC1 are of (J1939-71, SPN 544)."""
    error_nm: float = quantity("torque_error_nm", 0.1, 500.0, default=6.0)
    """Standard deviation of the torque that EEC1 says, beside what inertia and steps explain."""
    lag_s: float = quantity("lag_ms", 1.0, 1000.0, MS, default=80.0 * MS)
    """Time constant with which its torque follows what it is asked for, at most."""
