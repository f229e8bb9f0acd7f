"""The data sheet: what is known of a gearbox from its drawings, as one TOML file. Its wheels, and
what a ratio is: `wheels.py`."""

from __future__ import annotations

import hashlib
import itertools
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

from meshpoint.gearbox.driveline import Axle, Driveline, Engine
from meshpoint.gearbox.gears import (
    MAIN_GEARS,
    SPLIT_GEARS,
    DogGear,
    DriveGear,
    MainGear,
    Range,
    Sleeve,
    Split,
    SplitGear,
)
from meshpoint.gearbox.tables import (
    TableError,
    group,
    load_toml,
    merged_tables,
    quantity,
    read_group,
    read_values,
    text,
    to_table,
)
from meshpoint.gearbox.wheels import DogTeeth, MainBox, Mesh, RangeBox, Splitter, Wheels
from meshpoint.units import BAR, CM2, CM3, MM, MS, RPM

SHEET_NAMES: Final = ("thesis", "truck12", "thesis-dog", "truck12-dog")
BASED_ON: Final = "based_on"
"""A key of a sheet's file: the sheet that holds what this one leaves out."""
MOST_OVERLAYS: Final = 8
SENSOR_SD_PA: Final = 0.01 * BAR
"""Noise of the brake's pressure sensor where a sheet does not say: a thousandth of 10 bar."""
SPLITTER_CHOICE: Final = {"engagement": "cones", "dog": None}
"""What a sheet's splitter is where it does not say."""
_MAIN_FIELD: Final = {gear: gear.name.lower() for gear in MAIN_GEARS}


def _check_rising(group: str, meshes: dict[str, Mesh]) -> None:
    """TableError unless each step turns its driven shaft faster than the one before it."""
    for (slow, slower), (fast, faster) in itertools.pairwise(meshes.items()):
        if slower.exact >= faster.exact:
            raise TableError(
                f"{group}: teeth_driving / teeth_driven = {slower.driving}/{slower.driven} = "
                f"{slower.ratio:.3f} in {slow}, allowed is less than in {fast}, {faster.driving}/"
                f"{faster.driven} = {faster.ratio:.3f}"
            )


class SheetError(TableError):
    """A data sheet that cannot be used; the message names file, key, found and allowed."""


@dataclass(frozen=True)
class ShaftConstants:
    """Inertia and friction (thesis 4.10-4.13). The friction is that of layshaft and input shaft
    together, felt at the layshaft (4.11)."""

    layshaft_inertia_kgm2: float = quantity("layshaft_inertia_kgm2", 0.01, 5.0)
    """Inertia of the layshaft with all that is fixed to it (J_LS)."""
    input_inertia_kgm2: float = quantity("input_inertia_kgm2", 0.001, 5.0)
    """Inertia of the input shaft with the clutch plate (J_IS)."""
    friction_nms: float = quantity("friction_nms", 0.0, 2.0)
    """Friction torque a rad/s of the layshaft."""


@dataclass(frozen=True)
class Brake:
    """Layshaft disc brake and its valve (thesis 4.1-4.4)."""

    max_torque_nm: float = quantity("max_torque_nm", 5.0, 1000.0)
    """Torque at the layshaft at full supply pressure."""
    valve_delay_s: float = quantity("valve_delay_ms", 0.0, 50.0, MS)
    """From the valve's current to the first change of pressure."""
    time_constant_s: float = quantity("time_constant_ms", 1.0, 500.0, MS)
    """Time constant of the pressure's rise and fall."""
    valve_delay_tolerance: float = quantity(
        "valve_delay_tolerance_percent", 0.1, 100.0, 0.01, default=0.15
    )
    """By how much the valve's delay may differ, from valve to valve and with temperature."""
    time_constant_tolerance: float = quantity(
        "time_constant_tolerance_percent", 0.1, 100.0, 0.01, default=0.2
    )
    """By how much the pressure may rise and fall faster or slower, from pipe to pipe."""

    @property
    def least_valve_delay_s(self) -> float:
        """No valve of the tolerance is quicker."""
        return (1.0 - self.valve_delay_tolerance) * self.valve_delay_s

    @property
    def greatest_valve_delay_s(self) -> float:
        """No valve of the tolerance is slower."""
        return (1.0 + self.valve_delay_tolerance) * self.valve_delay_s


@dataclass(frozen=True)
class Air:
    """Supply and atmosphere; the gain K_valve of thesis 4.1 is the gauge pressure of the supply."""

    supply_gauge_pa: float = quantity("supply_gauge_bar", 1.0, 12.0, BAR)
    """Supply pressure above that of the air around."""
    atmosphere_pa: float = quantity("atmosphere_bar", 0.5, 1.2, BAR)
    """Pressure of the air around, absolute."""
    sensor_sd_pa: float = quantity("sensor_sd_bar", 1e-4, 5.0, BAR, default=SENSOR_SD_PA)
    """Noise of the brake's pressure sensor, standard deviation of a sample."""
    sensor_lag_s: float = quantity("sensor_lag_ms", 0.0, 50.0, MS, default=0.0)
    """By how much what it says, filtered, lags behind the pressure; it is learned."""


@dataclass(frozen=True)
class SleeveActuator:
    """Coupling sleeve with its two valves: a delay from activation to contact (thesis 6.2)."""

    delay_s: float = quantity("delay_ms", 10.0, 200.0, MS)
    """From the valve's current to the sleeve's contact with the gear."""
    delay_sd_s: float = quantity("delay_sd_ms", 0.0, 20.0, MS)
    """Standard deviation of that delay from shift to shift."""
    delay_limit_s: float = quantity("delay_limit_ms", 0.0, 50.0, MS)
    """The most by which that delay differs from its mean."""
    valve_delay_s: float = quantity("valve_delay_ms", 0.0, 50.0, MS)
    """From the valve's current to the sleeve's first movement."""
    to_contact_m: float = quantity("to_contact_mm", 0.5, 10.0, MM)
    """Way from neutral to the faces of the gear's teeth."""
    stroke_m: float = quantity("stroke_mm", 2.0, 20.0, MM)
    """Way from neutral to fully in."""
    speed_m_s: float = quantity("speed_m_s", 0.02, 2.0)
    """Speed of a sleeve that nothing stands before."""
    valve_delay_tolerance_s: float = quantity(
        "valve_delay_tolerance_ms", 0.01, 20.0, MS, default=2.0 * MS
    )
    """By how much a valve's delay may differ from that, on and off, from valve to valve."""
    bore_m2: float = quantity("bore_cm2", 1.0, 200.0, CM2, default=18.0 * CM2)
    """Area of the piston on which a chamber's pressure acts."""
    mass_kg: float = quantity("mass_kg", 0.1, 50.0, default=3.0)
    """All that moves: piston, rod, fork and sleeve."""
    friction_n: float = quantity("friction_n", 0.0, 5000.0, default=120.0)
    """Friction of a sleeve that moves: seals, rod and detent."""
    friction_tolerance: float = quantity(
        "friction_tolerance_percent", 0.1, 100.0, 0.01, default=0.3
    )
    """By how much that may differ, from sleeve to sleeve and with oil and wear."""
    damping_nsm: float = quantity("damping_nsm", 0.0, 20000.0, default=1200.0)
    """Force against the motion a m/s of speed."""
    damping_tolerance: float = quantity(
        "damping_tolerance_percent", 0.1, 300.0, 0.01, default=70.0 * 0.01
    )
    """By how much the damping may differ, from sleeve to sleeve and with the oil's temperature."""
    dead_m3: float = quantity("dead_cm3", 0.1, 2000.0, CM3, default=35.0 * CM3)
    """Volume of a chamber and its pipe with the piston at its near end."""
    dead_tolerance: float = quantity("dead_tolerance_percent", 0.1, 1000.0, 0.01, default=0.6)
    """By how much that may differ: a pipe's length is seldom stated."""
    vent_share: float = quantity("vent_percent", 10.0, 500.0, 0.01, default=1.25)
    """Conductance of a valve's way out over that of its way in. The way in itself is the one that
    gives `delay_ms`."""
    vent_tolerance: float = quantity("vent_tolerance_percent", 0.1, 100.0, 0.01, default=0.25)
    """By how much that share may differ."""
    detent_n: float = quantity("detent_n", 0.0, 5000.0, default=600.0)
    """The greatest force of the detent that holds a sleeve in neutral: 400 to 800 N is usual."""
    detent_tolerance_n: float = quantity("detent_tolerance_n", 0.1, 5000.0, default=150.0)
    """By how much the detent's force may differ."""
    detent_m: float = quantity("detent_mm", 0.1, 10.0, MM, default=2.0 * MM)
    """From neutral to where the detent no longer acts."""

    def __post_init__(self) -> None:
        if self.to_contact_m >= self.stroke_m:
            contact_mm, stroke_mm = self.to_contact_m / MM, self.stroke_m / MM
            raise TableError(
                f"to_contact_mm = {contact_mm:g}, allowed is less than stroke_mm = {stroke_mm:g}"
            )
        if self.valve_delay_s + self.delay_limit_s >= self.delay_s:
            least_ms = (self.valve_delay_s + self.delay_limit_s) / MS
            raise TableError(
                f"delay_ms = {self.delay_s / MS:g}, allowed is more than valve_delay_ms + "
                f"delay_limit_ms = {least_ms:g}"
            )


@dataclass(frozen=True)
class Clutch:
    """Clutch actuator as a delay from command to fully open and to fully closed."""

    open_delay_s: float = quantity("open_delay_ms", 0.0, 1000.0, MS)
    """From the command to fully open."""
    close_delay_s: float = quantity("close_delay_ms", 0.0, 2000.0, MS)
    """From the command to fully closed."""
    kiss_share: float = quantity("kiss_percent", 0.0, 100.0, 0.01, default=0.1)
    """The kiss point, at which the plates touch and part: travel from fully open."""
    kiss_tolerance: float = quantity("kiss_tolerance_percent", 0.0, 50.0, 0.01, default=0.05)
    """By how much the kiss point may differ from that, from clutch to clutch and with wear."""

    @property
    def surely_open_share(self) -> float:
        """The plates are apart from here on, whichever clutch of the tolerance it is."""
        return max(0.0, self.kiss_share - self.kiss_tolerance)

    @property
    def likely_open_share(self) -> float:
        """The plates are apart from here on in all but the clutches whose kiss point is lower by
        more than half of the tolerance."""
        return max(0.0, self.kiss_share - 0.5 * self.kiss_tolerance)


@dataclass(frozen=True)
class SheetLimits:
    """What the shafts must not exceed."""

    input_max_rad_s: float = quantity("input_max_rpm", 500.0, 6000.0, RPM)
    """The highest speed of the input shaft, and of the engine with it."""


@dataclass(frozen=True)
class GearboxSheet:
    """A whole gearbox. Attributes are SI; tooth counts are exact integers."""

    name: str = text("name")
    """What the gearbox is called in results and reports."""
    splitter: Splitter = group(Splitter)
    main: MainBox = group(MainBox)
    range_: RangeBox = group(RangeBox)
    dog: DogTeeth = group(DogTeeth)
    wheels: Wheels = group(Wheels)
    shafts: ShaftConstants = group(ShaftConstants)
    brake: Brake = group(Brake)
    air: Air = group(Air)
    sleeve: SleeveActuator = group(SleeveActuator)
    clutch: Clutch = group(Clutch)
    limits: SheetLimits = group(SheetLimits)
    driveline: Driveline = group(Driveline, default=Driveline())
    axle: Axle = group(Axle, default=Axle())
    engine: Engine = group(Engine, default=Engine())

    def __post_init__(self) -> None:
        _check_rising("main", {_MAIN_FIELD[gear]: self.main_mesh(gear) for gear in MAIN_GEARS})
        _check_rising("splitter", {"low": self.splitter.low, "high": self.splitter.high})
        _check_rising("range", {"low": self.range_.low, "high": self.range_.high})

    def main_mesh(self, gear: MainGear) -> Mesh:
        """The wheel pair of a main-box gear. KeyError for neutral."""
        mesh: Mesh = getattr(self.main, _MAIN_FIELD[gear])
        return mesh

    @property
    def has_dog_splitter(self) -> bool:
        """Whether the splitter's sleeve has dog teeth alone."""
        return self.splitter.engagement == "dog"

    @property
    def dog_gears(self) -> tuple[DogGear, ...]:
        """All gears that are engaged by dog teeth alone."""
        return (*MAIN_GEARS, *SPLIT_GEARS) if self.has_dog_splitter else MAIN_GEARS

    def dog_mesh(self, gear: DogGear) -> Mesh:
        """The wheel pair from the layshaft to a gear that a sleeve engages, on the main shaft or on
        the input shaft. KeyError for neutral."""
        if isinstance(gear, SplitGear):
            mesh = self.split_mesh(gear.split)
            return Mesh(mesh.driven, mesh.driving)
        return self.main_mesh(gear)

    def teeth_of(self, sleeve: Sleeve) -> DogTeeth:
        """The dog teeth of a sleeve and its gears."""
        return self.splitter.dog or self.dog if sleeve is Sleeve.SPLITTER else self.dog

    def split_mesh(self, split: Split) -> Mesh:
        """The wheel pair of a splitter step."""
        return self.splitter.low if split is Split.LOW else self.splitter.high

    def range_mesh(self, range_: Range) -> Mesh:
        """The wheel pair of a range step."""
        return self.range_.low if range_ is Range.LOW else self.range_.high

    def inertia_kgm2(self, split: Split) -> float:
        """Inertia felt at the layshaft, J_LS + J_IS / i_split^2 (thesis 4.13)."""
        ratio = self.split_mesh(split).ratio
        return self.shafts.layshaft_inertia_kgm2 + self.shafts.input_inertia_kgm2 / ratio**2

    def geared_kgm2(self, gear: DriveGear) -> float:
        """Inertia of input shaft and layshaft with a gear in mesh, felt at the propeller shaft."""
        input_ratio = self.overall_ratio(gear)
        layshaft_ratio = input_ratio * self.split_mesh(gear.split).ratio
        shafts = self.shafts
        turned = shafts.input_inertia_kgm2 * input_ratio**2
        return turned + shafts.layshaft_inertia_kgm2 * layshaft_ratio**2

    @property
    def brake_nm_per_pa(self) -> float:
        """C_db of thesis 4.4 on gauge pressure, unsigned: the torque acts against rotation."""
        return self.brake.max_torque_nm / self.air.supply_gauge_pa

    def overall_ratio(self, gear: DriveGear) -> float:
        """Input speed over propeller speed, the ratio people quote."""
        turns = (
            self.split_mesh(gear.split).exact
            * self.main_mesh(gear.main).exact
            * self.range_mesh(gear.range_).exact
        )
        return float(1 / turns)

    def canonical(self) -> str:
        """The sheet as one line of JSON with sorted keys: what its hash and the run header hold."""
        table = to_table(self)
        if not self.has_dog_splitter:  # as sheets were before there was a choice
            for key in SPLITTER_CHOICE:
                del table["splitter"][key]
        return json.dumps(table, sort_keys=True, separators=(",", ":"))

    @property
    def sha256(self) -> str:
        """Hash of the values, not of the file's bytes: a comment changes nothing."""
        return hashlib.sha256(self.canonical().encode()).hexdigest()


def load_sheet(name_or_path: str | Path) -> GearboxSheet:
    """A sheet by name (`thesis`) or from a TOML file. SheetError names file, key and allowed."""
    if str(name_or_path) in SHEET_NAMES:
        source = resources.files("meshpoint.gearbox") / "sheets" / f"{name_or_path}.toml"
        with resources.as_file(source) as path:
            return _read_sheet(path)
    path = Path(name_or_path)
    if not path.exists():
        known = ", ".join(SHEET_NAMES)
        raise SheetError(f"{path}: no such file, and no sheet of that name; sheets are {known}")
    return _read_sheet(path)


def _read_sheet(path: Path) -> GearboxSheet:
    try:
        return read_group(GearboxSheet, _tables(path, MOST_OVERLAYS), path.name)
    except TableError as error:
        raise SheetError(str(error)) from error


def _tables(path: Path, overlays: int) -> dict[str, Any]:
    """A file's tables; over those of the sheet that it is `based_on`, where it names one: a sheet
    of ours, or a file beside it."""
    tables = load_toml(path)
    base = tables.pop(BASED_ON, None)
    if base is None:
        return tables
    if not isinstance(base, str):
        raise TableError(f"{path.name}: {BASED_ON} = {base!r}, allowed is a sheet's name or file")
    if overlays == 0:
        raise TableError(
            f"{path.name}: {BASED_ON}: more than {MOST_OVERLAYS} sheets one on another"
        )
    if base in SHEET_NAMES:
        source = resources.files("meshpoint.gearbox") / "sheets" / f"{base}.toml"
        with resources.as_file(source) as below:
            return merged_tables(_tables(below, overlays - 1), tables)
    return merged_tables(_tables(path.parent / base, overlays - 1), tables)


def sheet_from_canonical(values: dict[str, Any]) -> GearboxSheet:
    """The inverse of `canonical`, parsed: how a run header gives back its sheet (SI values).
    TableError names key, found and allowed."""
    splitter = values.get("splitter")
    if isinstance(splitter, dict) and not set(SPLITTER_CHOICE) & set(splitter):
        values = values | {"splitter": SPLITTER_CHOICE | splitter}
    return read_values(GearboxSheet, values, "sheet")
