"""The gearbox as an FMU: valid by FMPy, and the same gearbox as on the bus."""

from __future__ import annotations

import gc
import math
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from meshpoint.bridges.driven_rig import DrivenRig, Inputs, outputs
from meshpoint.cli.main import main
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter, read_alone
from meshpoint.dbc.messages import (
    TSC1,
    BenchCommand,
    ClutchAction,
    ClutchCommand,
    EngagementEvent,
    ReferenceEngagement,
    TscOverrideMode,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Profile, RigSettings

SEED, STEP_US = 3, 10_000
CONTACTS = (EngagementEvent.GAP_CONTACT, EngagementEvent.TOOTH_CONTACT)
PLAN = {30: "clutch opens", 37: "pulls", 39: "pulled", 55: "brakes", 72: "released", 75: "fires"}
"""What is asked from these steps on."""


class Unit:
    """An instance of the FMU, its variables by name."""

    def __init__(self, path: Path, **parameters: Any) -> None:
        about = read_model_description(path)
        self._variables = {each.name: each for each in about.modelVariables}
        self.folder = extract(path)
        self.slave = FMU3Slave(
            instanceName="rig",
            guid=about.instantiationToken,
            modelIdentifier=about.coSimulation.modelIdentifier,
            unzipDirectory=self.folder,
        )
        self.slave.instantiate()
        for name, value in parameters.items():
            self.put(name, value)
        self.slave.enterInitializationMode()

    def begin(self) -> Unit:
        """The parameters are as they are to be."""
        self.slave.exitInitializationMode()
        return self

    def put(self, name: str, value: Any) -> None:
        of = self._variables[name]
        getattr(self.slave, f"set{of.type}")([of.valueReference], [value])

    def get(self, name: str) -> Any:
        of = self._variables[name]
        return getattr(self.slave, f"get{of.type}")([of.valueReference])[0]

    def step(self, k: int) -> None:
        self.slave.doStep(
            currentCommunicationPoint=k * STEP_US / 1e6, communicationStepSize=STEP_US / 1e6
        )

    def end(self) -> None:
        self.slave.terminate()
        self.free()

    def free(self) -> None:
        self.slave.freeInstance()
        shutil.rmtree(self.folder)


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "rig.fmu"
    assert main(["fmu", "-o", str(path)]) == 0
    return path


@pytest.fixture
def unit(fmu: Path) -> Iterator[Unit]:
    unit = Unit(fmu, seed=SEED, profile="clean").begin()
    yield unit
    unit.end()


def asked_at(k: int) -> dict[str, Any]:
    """What is commanded in a step: valves that are on, and the clutch."""
    begun = [text for at, text in PLAN.items() if at <= k]
    on = {"pulls": "main_second", "brakes": "brake", "fires": "main_second"}.get(
        begun[-1] if begun else ""
    )
    return {"on": on, "clutch_closed": not begun}


def rigs_own(steps: int) -> list[ReferenceEngagement]:
    """The contacts of a rig on the bus that gets these commands."""
    rig = RigCore(load_sheet("truck12"), RigSettings(seed=SEED, profile=Profile.CLEAN))
    node, bench = Transmitter(Node.TRANSMISSION_CONTROL), Transmitter(Node.BENCH)
    engaged = CODECS["ReferenceEngagement"]
    found = []
    for k in range(steps):
        asked = asked_at(k)
        valves = ValveCommand()
        if asked["on"] is not None:
            valves = valves._replace(**{f"{asked['on']}_action": ValveAction.ON_NOW})
        clutch = ClutchAction.CLOSE if asked["clutch_closed"] else ClutchAction.OPEN
        torque = TSC1(
            override_control_mode=TscOverrideMode.TORQUE_CONTROL,
            requested_torque_fraction=0.0,
            requested_torque_fine_fraction=0.0,
        )
        for message in (valves, ClutchCommand(action=clutch), torque):
            rig.receive(node.encode(message))
        rig.receive(bench.encode(BenchCommand()))
        for now_us in (k * STEP_US, (k + 1) * STEP_US):
            for frame in rig.step(now_us).frames:
                message = read_alone(engaged, frame)
                if message is not None and message.event in CONTACTS:
                    found.append(message)
    return found


def test_it_is_valid_fmi_3(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    about = read_model_description(str(fmu))
    assert about.fmiVersion == "3.0"
    assert about.coSimulation is not None
    names = {each.name for each in about.modelVariables}
    assert {"main_third_on", "layshaft_angle_rad", "contact_time_s", "seed", "gearbox"} <= names


def test_the_contact_of_a_shift_is_that_of_the_rig_on_the_bus(unit: Unit) -> None:
    unit.put("engine_control", 2)
    steps = 100
    for k in range(steps):
        asked = asked_at(k)
        for valve in ("brake", "main_second"):
            unit.put(f"{valve}_on", asked["on"] == valve)
        unit.put("clutch_closed", asked["clutch_closed"])
        unit.step(k)
    contacts = rigs_own(steps)
    assert unit.get("contact_count") == len(contacts) > 0
    last = contacts[-1]
    start_us = RigCore(
        load_sheet("truck12"), RigSettings(seed=SEED, profile=Profile.CLEAN)
    ).truth.clock_start_us
    since_us = (last.event_time_us - start_us) % 2**32
    assert unit.get("contact_time_s") == pytest.approx(since_us * 1e-6, abs=1e-9)
    assert unit.get("contact_gear") == last.gear
    assert unit.get("contact_phase_rad") == last.phase_rad
    assert unit.get("contact_slip_rad_s") == last.slip_rad_s
    assert unit.get("contact_in_gap") is (last.event is EngagementEvent.GAP_CONTACT)


def test_the_layshaft_turns_as_far_as_its_speed_says(unit: Unit) -> None:
    angles, speeds = [], []
    for k in range(60):
        unit.step(k)
        angles.append(unit.get("layshaft_angle_rad"))
        speeds.append(unit.get("layshaft_speed_rad_s"))
    turned = 0.01 * (sum(speeds) - (speeds[0] + speeds[-1]) / 2)
    assert angles[-1] - angles[0] == pytest.approx(turned, rel=1e-3)


def test_uphill_the_vehicle_slows_more_without_torque(fmu: Path) -> None:
    """By g times the slope, less what the turning parts carry on."""
    lost_m_s = []
    for added_percent in (0.0, 5.0):
        unit = Unit(fmu, seed=SEED).begin()
        unit.put("slope_added_percent", added_percent)
        unit.put("clutch_closed", False)
        unit.step(0)
        before_m_s = unit.get("road_speed_m_s")
        for k in range(1, 101):
            unit.step(k)
        lost_m_s.append(before_m_s - unit.get("road_speed_m_s"))
        unit.end()
    assert lost_m_s[1] - lost_m_s[0] == pytest.approx(9.81 * 0.05, rel=0.1)


@pytest.mark.parametrize(
    "parameters",
    [{"profile": "rough"}, {"gearbox": "nowhere.toml"}, {"start_gear": 15}, {"seed": -1}],
)
def test_a_parameter_that_cannot_be_used_ends_the_initialization(
    fmu: Path, parameters: dict[str, Any], capfd: pytest.CaptureFixture[str]
) -> None:
    unit = Unit(fmu, **parameters)
    with pytest.raises(FMICallException):
        unit.begin()
    unit.free()
    gc.collect()  # what the wrapper has released twice is whole
    assert f"{next(iter(parameters))}: " in capfd.readouterr().out
    Unit(fmu, profile="clean").begin().end()


def test_time_is_that_of_the_last_step_s_end(unit: Unit) -> None:
    assert unit.get("time") == 0.0
    unit.step(0)
    unit.step(1)
    assert unit.get("time") == pytest.approx(0.02)


def test_every_real_variable_has_a_unit_in_si(fmu: Path) -> None:
    about = read_model_description(fmu)
    units = {each.name: each.unit for each in about.modelVariables if each.type == "Float64"}
    assert units["time"] == "s"
    assert units["layshaft_speed_rad_s"] == "rad/s"
    assert units["range_m"] == "m"
    assert units["road_speed_m_s"] == "m/s"
    assert units["contact_time_s"] == "s"
    assert None not in units.values()
    (rpm,) = (each for each in about.unitDefinitions if each.name == "rpm")
    assert rpm.baseUnit.factor == pytest.approx(2 * math.pi / 60)
    assert (rpm.baseUnit.rad, rpm.baseUnit.s) == (1, -1)


def test_steps_may_differ_in_size_and_the_unit_says_so(fmu: Path, unit: Unit) -> None:
    about = read_model_description(fmu)
    assert about.coSimulation.canHandleVariableCommunicationStepSize
    time_s = 0.0
    for step_s in (0.01, 0.0005, 0.05, 0.003):
        unit.slave.doStep(currentCommunicationPoint=time_s, communicationStepSize=step_s)
        time_s += step_s
    assert unit.get("time") == pytest.approx(time_s)


ENDS = """
import sys
from pathlib import Path
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

def heard(event, given):
    if event == "ctypes.dlsym" and given[1] == "finalizePythonInterpreter":
        print("releases", Path(given[0]._name).name, flush=True)

sys.addaudithook(heard)
path = sys.argv[1]
about, folder = read_model_description(path), extract(path)
for name in ("one", "two"):
    slave = FMU3Slave(
        instanceName=name, guid=about.instantiationToken, unzipDirectory=folder,
        modelIdentifier=about.coSimulation.modelIdentifier,
    )
    slave.instantiate()
    slave.freeInstance()
print("at the end:", flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the wrapper of Windows has no such end")
def test_the_wrapper_releases_its_state_before_the_process_ends(fmu: Path) -> None:
    """After it, it would count down in memory that is free: `fmpy simulate` aborted."""
    done = subprocess.run(
        [sys.executable, "-c", ENDS, str(fmu)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["at the end:", "releases GearboxRig.so"]


@pytest.mark.long
def test_fmpy_simulates_it_and_ends_well(fmu: Path) -> None:
    """Three runs of five aborted with 134."""
    command = [Path(sys.executable).with_name("fmpy"), "simulate", fmu]
    assert [subprocess.run(command, check=False).returncode for _ in range(5)] == [0] * 5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("slope_added_percent", math.nan),
        ("slope_added_percent", 1e4),
        ("engine_control", 7),
        ("engine_torque_asked_fraction", math.inf),
        ("bench_gear", 15),
    ],
)
def test_an_input_that_cannot_be_ends_the_step(unit: Unit, name: str, value: float) -> None:
    unit.step(0)
    unit.put(name, value)
    with pytest.raises(FMICallException):
        unit.step(1)


@pytest.mark.parametrize(
    ("time_s", "step_s"), [(0.01, 0.0), (0.01, -0.1), (0.01, math.nan), (0.0, 0.01), (5.0, 0.01)]
)
def test_time_goes_on_step_by_step(unit: Unit, time_s: float, step_s: float) -> None:
    unit.step(0)
    with pytest.raises(FMICallException):
        unit.slave.doStep(currentCommunicationPoint=time_s, communicationStepSize=step_s)


@pytest.mark.parametrize("step_us", [500, 1_000, 2_500, 50_000])
def test_the_step_size_changes_nothing_but_when_inputs_are_read(step_us: int) -> None:
    """All inputs change at multiples of 50 ms."""

    def contacts(each_us: int) -> tuple[int, int, Any]:
        sheet = load_sheet("truck12")
        rig = DrivenRig(sheet, RigSettings(seed=SEED, profile=Profile.CLEAN))
        for now_us in range(0, 1_000_000, each_us):
            inputs = Inputs(engine_torque_fraction=0.0, clutch_closed=now_us < 300_000)
            inputs.valves["main_second"] = now_us >= 400_000
            rig.advance(now_us, now_us + each_us, inputs)
        return rig.contact.count, rig.contact.time_us, outputs(rig)

    count, time_us, found = contacts(step_us)
    assert count == 1
    assert (count, time_us) == contacts(10_000)[:2]
    assert found == pytest.approx(contacts(10_000)[2], rel=1e-6)


def test_bad_input_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fmu", "-o", str(tmp_path / "x.zip")]) == 2
    assert "ends in '.zip', allowed is .fmu" in capsys.readouterr().err
    assert main(["fmu", "-o", str(tmp_path / "none" / "x.fmu")]) == 2
    assert "x.fmu: cannot be written: No such file" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pythonfmu3", None)
    assert main(["fmu", "-o", str(tmp_path / "x.fmu")]) == 2
    assert "pip install 'meshpoint[fmu]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
