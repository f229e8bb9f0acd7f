"""The truck on a stand: a free output that rests, and a drive in place of the engine."""

from __future__ import annotations

from typing import Final

STAND: Final = {
    "vehicle.slope_percent": 0.0,
    "vehicle.mass_kg": 5000.0,
    "vehicle.wheel_radius_m": 0.3,
    "vehicle.axle_ratio": 7.0,
    "vehicle.rolling_resistance": 0.012,
    "driveline.stiffness_nm_rad": 0.0,
    "driveline.wheels_kgm2": 0.0,
    "engine.idle_rpm": 0.0,
}
"""As-built values: 9 kg m2 behind the propeller shaft, that coast, without axle shafts and wheels;
and an engine that rests until TSC1 asks for a speed. With a main shaft that stands at the start,
nothing turns by itself."""
