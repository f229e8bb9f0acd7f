"""The FMU's own script: variables of FMI 3.0 around a `DrivenRig`.

`meshpoint fmu` packs it. It runs in the Python of whoever imports the FMU, which needs meshpoint.
"""

from __future__ import annotations

import math
from typing import Any, Final
from xml.etree.ElementTree import Element

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
    Unit,
)

from meshpoint.bridges.driven_rig import VALVES, DrivenRig, Inputs, outputs
from meshpoint.bridges.fmu_wrapper import end_well, hold
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.wheels import SHAFTS
from meshpoint.rig_sim.settings import Profile, RigSettings

NO_REQUEST, SPEED, TORQUE = range(3)
"""Values of `engine_control`."""
RANGES = {
    "engine_control": (NO_REQUEST, TORQUE),
    "engine_speed_asked_rad_s": (0.0, 800.0),
    "engine_torque_asked_fraction": (-1.25, 1.25),
    "bench_gear": (0, 14),
    "bench_main_speed_rad_s": (0.0, 500.0),
    "slope_added_percent": (-20.0, 20.0),
}
"""Least and greatest value of each input that is a number; none of them may be no number."""
UNITS: Final = {
    "rad_s": Unit("rad/s", rad=1, s=-1),
    "rad": Unit("rad", rad=1),
    "m_s": Unit("m/s", m=1, s=-1),
    "m": Unit("m", m=1),
    "pa": Unit("Pa", kg=1, m=-1, s=-2),
    "rpm": Unit("rpm", rad=1, s=-1, factor=math.pi / 30.0),
    "percent": Unit("%", factor=0.01),
    "fraction": Unit("1"),
    "s": Unit("s", s=1),
}
"""By the end of a variable's name, longer ends first."""
LEAST_STEP_S, MOST_STEP_S = 1e-6, 10.0
REFUSALS = (OSError, ValueError, TypeError, OverflowError)
"""What a value that cannot be used raises."""


class GearboxRig(Fmi3Slave):  # type: ignore[misc]  # pythonfmu3 has no types
    """A truck's unsynchronised gearbox, as built from a seed: valves in, shafts and sleeves out."""

    description = "meshpoint's virtual gearbox: pneumatic dog-clutch sleeves, brake, driveline"

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        end_well(given.get("resources") or "")
        self.register_units([*UNITS.values()])
        self._rig: DrivenRig | None = None
        self._end_us: int | None = None
        self._ended = False
        self._values: dict[str, Any] = {}
        """Of every variable, by its name."""
        self._add(Float64, "time", Fmi3Causality.independent, 0.0, "since power-up, s")
        self._parameters()
        self._inputs()
        self._outputs()

    def _add(
        self, kind: Any, name: str, causality: Any, start: Any, text: str, **more: Any
    ) -> None:
        """A variable kept in `_values`; a real one in the unit that its name ends with."""
        self._values[name] = start
        if kind is Float64:
            end = next((end for end in UNITS if name.endswith(f"_{end}")), "s")  # `time`
            more["unit"] = UNITS[end].name
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

    def to_xml(self, model_options: Any = None) -> Element:
        """The unit's description. That steps may differ in size is said here: pythonfmu3 writes the
        value of another option there."""
        root: Element = super().to_xml(model_options or {})
        for each in root.iter("CoSimulation"):
            each.set("canHandleVariableCommunicationStepSize", "true")
        return root

    def exit_initialization_mode(self) -> None:
        """Builds the gearbox from the parameters. Raises one of `REFUSALS` where one cannot be
        used: the wrapper logs it, and the importer gets status `fatal`."""
        try:
            self._rig = self._built()
        except REFUSALS:
            hold(self, type(self), self.log_queue)
            raise
        self._show()

    def _built(self) -> DrivenRig:
        value, profiles = self._values, [str(each) for each in Profile]
        if value["profile"] not in profiles:
            raise ValueError(f"profile: found {value['profile']!r}, allowed: {', '.join(profiles)}")
        try:
            sheet = load_sheet(value["gearbox"])
        except (OSError, ValueError) as error:
            raise ValueError(f"gearbox: {error}") from error
        settings = RigSettings(
            seed=value["seed"],
            profile=Profile(value["profile"]),
            start_gear=value["start_gear"],
            main_speed_rpm=value["start_main_speed_rpm"],
        )
        return DrivenRig(sheet, settings)

    def _refuse(self, error: Exception) -> Fmi3StepResult:
        self.log(str(error), Fmi3Status.error)
        return Fmi3StepResult(status=Fmi3Status.error)

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Goes on by a step with the inputs as they are. Status `error` where the step or an input
        cannot be; what was found and what is allowed is logged."""
        try:
            self._go_on(current_time, step_size)
        except REFUSALS as error:
            return self._refuse(error)
        return Fmi3StepResult(status=Fmi3Status.ok)

    def _go_on(self, current_time: float, step_size: float) -> None:
        if self._rig is None:
            raise ValueError("a step before the initialization has ended")
        for name, (least, most) in RANGES.items():
            if not least <= self._values[name] <= most:
                raise ValueError(f"{name}: found {self._values[name]}, allowed: {least} to {most}")
        if self._ended:
            raise ValueError("a step after the end of the simulation")
        if not LEAST_STEP_S <= step_size <= MOST_STEP_S:
            allowed = f"{LEAST_STEP_S:g} to {MOST_STEP_S:g}"
            raise ValueError(f"step size: found {step_size} s, allowed: {allowed}")
        begin_us, end_us = (round(1e6 * at_s) for at_s in (current_time, current_time + step_size))
        if self._end_us is not None and begin_us != self._end_us:
            stands_s = self._end_us * 1e-6
            raise ValueError(
                f"time: found {current_time} s, allowed: {stands_s:g}, where it stands"
            )
        self._end_us = end_us
        self._rig.advance(begin_us, end_us, self._asked())
        self._values["time"] = current_time + step_size
        self._show()

    def terminate(self) -> None:
        """No step follows."""
        self._ended = True

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
        if self._rig is not None:
            self._values |= outputs(self._rig)
