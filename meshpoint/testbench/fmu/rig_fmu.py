"""The FMU's own script: variables of FMI 3.0 around a `DrivenRig`.

`meshpoint fmu` packs it. It runs in the Python of whoever imports the FMU, which needs meshpoint.
"""

from __future__ import annotations

from typing import Any

from pythonfmu3 import (
    Boolean,
    Float64,
    Fmi3Causality,
    Fmi3Slave,
    Fmi3Status,
    Fmi3StepResult,
    Fmi3Variability,
    Int32,
    String,
)

from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile, RigSettings
from meshpoint.testbench.fmu.driven_rig import SHAFTS, VALVES, DrivenRig, Inputs, outputs

NO_REQUEST, SPEED, TORQUE = range(3)
"""Values of `engine_control`."""


class GearboxRig(Fmi3Slave):  # type: ignore[misc]  # pythonfmu3 has no types
    """A truck's unsynchronised gearbox, as built from a seed: valves in, shafts and sleeves out."""

    description = "meshpoint's virtual gearbox: pneumatic dog-clutch sleeves, brake, driveline"

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self._rig: DrivenRig
        self._values: dict[str, Any] = {}
        """Of every variable, by its name."""
        self._add(Float64, "time", Fmi3Causality.independent, 0.0, "since power-up, s")
        self._parameters()
        self._inputs()
        self._outputs()

    def _add(
        self, kind: Any, name: str, causality: Any, start: Any, text: str, **more: Any
    ) -> None:
        """A variable kept in `_values`."""
        self._values[name] = start
        self.register_variable(
            kind(
                name,
                causality=causality,
                description=text,
                getter=lambda: self._values[name],
                setter=lambda value: self._values.__setitem__(name, value),
                **more,
            )
        )

    def _parameters(self) -> None:
        of, fixed = Fmi3Causality.parameter, {"variability": Fmi3Variability.fixed}
        self._add(String, "gearbox", of, "truck12", "data sheet: a name, or a TOML file", **fixed)
        self._add(String, "profile", of, "typical", "clean, typical or harsh", **fixed)
        self._add(Int32, "seed", of, 1, "draws what is as built, and all scatter", **fixed)
        self._add(Int32, "start_gear", of, 8, "gear at the start, 1 to 14", **fixed)
        self._add(Float64, "start_main_speed_rpm", of, 644.0, "main shaft at the start", **fixed)

    def _inputs(self) -> None:
        of = Fmi3Causality.input
        discrete = {"variability": Fmi3Variability.discrete}
        for valve in VALVES:
            self._add(Boolean, f"{valve}_on", of, False, f"coil of the {valve} valve", **discrete)
        self._add(Boolean, "clutch_closed", of, True, "what the clutch is to be", **discrete)
        self._add(Int32, "engine_control", of, NO_REQUEST, "0 none, 1 speed, 2 torque", **discrete)
        self._add(Float64, "engine_speed_asked_rad_s", of, 0.0, "with engine_control 1")
        self._add(Float64, "engine_torque_asked_fraction", of, 0.0, "with engine_control 2")
        self._add(
            Int32, "bench_gear", of, 0, "where it changes: the bench brings it in", **discrete
        )
        self._add(Float64, "bench_main_speed_rad_s", of, 0.0, "main shaft speed of the bench")
        self._add(Float64, "slope_added_percent", of, 0.0, "to the road's slope that was drawn")

    def _outputs(self) -> None:
        of, discrete = Fmi3Causality.output, {"variability": Fmi3Variability.discrete}
        for shaft in SHAFTS:
            self._add(Float64, f"{shaft}_angle_rad", of, 0.0, f"angle of the {shaft} shaft")
            self._add(Float64, f"{shaft}_speed_rad_s", of, 0.0, f"speed of the {shaft} shaft")
        self._add(Float64, "road_speed_m_s", of, 0.0, "speed of the vehicle")
        self._add(Float64, "engine_speed_rad_s", of, 0.0, "as EEC1 says")
        for sleeve in ("first_second", "crawl_third", "splitter", "range"):
            self._add(Float64, f"{sleeve}_m", of, 0.0, "sleeve as its sensor says, 0 neutral")
        self._add(Float64, "brake_pressure_pa", of, 0.0, "as its sensor says, absolute")
        self._add(Float64, "supply_pressure_pa", of, 0.0, "as its sensor says, absolute")
        self._add(Float64, "clutch_position_fraction", of, 1.0, "as its sensor says, 1 closed")
        self._add(Int32, "contact_count", of, 0, "how often a sleeve has met its gear", **discrete)
        self._add(Float64, "contact_time_s", of, 0.0, "of the last, since power-up", **discrete)
        self._add(Int32, "contact_gear", of, 0, "main-box gear, as in the DBC", **discrete)
        self._add(Boolean, "contact_in_gap", of, False, "tooth met gap, not tooth", **discrete)
        self._add(Float64, "contact_phase_rad", of, 0.0, "from the gap's middle", **discrete)
        self._add(Float64, "contact_slip_rad_s", of, 0.0, "gear less sleeve", **discrete)

    def exit_initialization_mode(self) -> None:
        """Builds the gearbox from the parameters."""
        value = self._values
        settings = RigSettings(
            seed=value["seed"],
            profile=Profile(value["profile"]),
            start_gear=value["start_gear"],
            main_speed_rpm=value["start_main_speed_rpm"],
        )
        self._rig = DrivenRig(load_sheet(value["gearbox"]), settings)
        self._show()

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Goes on by a step with the inputs as they are."""
        begin_us, end_us = (round(1e6 * at_s) for at_s in (current_time, current_time + step_size))
        self._rig.advance(begin_us, end_us, self._asked())
        self._show()
        return Fmi3StepResult(status=Fmi3Status.ok)

    def _asked(self) -> Inputs:
        value, control = self._values, self._values["engine_control"]
        torque, speed = value["engine_torque_asked_fraction"], value["engine_speed_asked_rad_s"]
        return Inputs(
            valves={valve: value[f"{valve}_on"] for valve in VALVES},
            clutch_closed=value["clutch_closed"],
            engine_speed_rad_s=speed if control == SPEED else None,
            engine_torque_fraction=torque if control == TORQUE else None,
            gear=value["bench_gear"],
            main_speed_rad_s=value["bench_main_speed_rad_s"],
            slope_added_percent=value["slope_added_percent"],
        )

    def _show(self) -> None:
        self._values |= outputs(self._rig)
