"""The content of a calibration file: what a controller has learned of one gearbox.

Every figure has its range; together they must suit the data sheet (`check`). Quantities are in SI
here and in the units of their keys in the file (docs/calibration.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Final, Self

from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.table_text import to_toml
from meshpoint.gearbox.tables import (
    TableError,
    count,
    flag,
    group,
    parse_toml,
    quantities,
    quantity,
    read_group,
    text,
)
from meshpoint.units import BAR, DEG, MM, MS, RPM, TURN, US

CALIBRATION_FORMAT: Final = 1
MOST_SHIFTS: Final = 1_000_000_000
MOST_MOVEMENTS: Final = 1_000_000_000
PITCH_SHARE: Final = 0.25
"""Largest tooth error in pitches; a larger one belongs to another wheel."""
COMMENT: Final = """\
meshpoint: what a controller has learned of one gearbox. Written by the controller;
a file that does not hold together is refused as a whole (docs/calibration.md)."""


class CalibrationError(TableError):
    """A calibration that cannot be used; the message names key, found and allowed."""


@dataclass(frozen=True)
class Provenance:
    """Where a calibration comes from."""

    meshpoint: str = text("meshpoint")
    """The version that wrote it."""
    sheet: str = text("sheet")
    sheet_sha256: str = text("sheet_sha256")
    """Of the data sheet it was learned with."""
    written: str = text("written")
    """Date and time as text, from the driver."""
    shifts: int = count("shifts", 0, MOST_SHIFTS)
    """Shifts that ended since learning began, over all runs."""


@dataclass(frozen=True)
class WheelRecord:
    """The edges of one sensor wheel (`controller/estimate/teeth.py`)."""

    teeth: int = count("teeth", 2, 1000)
    edges: int = count("learned_from_edges", 0, 1 << 62)
    sd_rad: float = quantity("sd_deg", 1e-4, 5.0, DEG)
    """Standard deviation of an edge's place."""
    error_rad: tuple[float, ...] = quantities("error_deg", -5.0, 5.0, DEG)
    """Edge 2 k is the rising one of tooth k, 2 k + 1 its falling one; tooth 0 is any one."""

    def __post_init__(self) -> None:
        if len(self.error_rad) != 2 * self.teeth:
            found = f"error_deg holds {len(self.error_rad)} numbers"
            raise TableError(f"{found}, allowed are {2 * self.teeth}: two a tooth")


@dataclass(frozen=True)
class WheelRecords:
    """The wheels whose teeth are known."""

    layshaft: WheelRecord | None = group(WheelRecord, default=None)
    main: WheelRecord | None = group(WheelRecord, default=None)


@dataclass(frozen=True)
class ReferenceRecords:
    """Phase references (`estimate/reference.py`), in the numbering of the wheels' teeth."""

    crawl_rad: float | None = quantity("crawl_deg", -180.0, 180.0, DEG, default=None)
    first_rad: float | None = quantity("first_deg", -180.0, 180.0, DEG, default=None)
    second_rad: float | None = quantity("second_deg", -180.0, 180.0, DEG, default=None)
    third_rad: float | None = quantity("third_deg", -180.0, 180.0, DEG, default=None)

    @property
    def offsets_rad(self) -> dict[MainGear, float]:
        """Those that are known, by gear."""
        given = {gear: getattr(self, f"{gear.name.lower()}_rad") for gear in MAIN_GEARS}
        return {gear: offset for gear, offset in given.items() if offset is not None}


class OfFigures:
    """A record of figures: its numbers are in turn the value of one and its deviation."""

    @classmethod
    def of(cls, *figures: Any, **others: Any) -> Self:
        """The record of figures, each of which has `value` and `sd`, in the order of the fields;
        others: its other fields."""
        numbers = [number for one in figures for number in (one.value, one.sd)]
        make: Callable[..., Self] = cls
        return make(**dict(zip(cls._numbers(), numbers, strict=True)), **others)

    @property
    def figures(self) -> list[tuple[float, float]]:
        """Value and deviation of each, in the same order."""
        numbers = [getattr(self, name) for name in self._numbers()]
        return list(zip(numbers[::2], numbers[1::2], strict=True))

    @classmethod
    def _numbers(cls) -> list[str]:
        own: Any = fields(cls)  # type: ignore[arg-type]
        return [field.name for field in own if field.metadata["rule"].kind is float]


@dataclass(frozen=True)
class BrakeRecord(OfFigures):
    """The layshaft brake (`controller/estimate/brake_model.py`)."""

    shifts: int = count("learned_from_shifts", 0, MOST_SHIFTS)
    gain: float = quantity("gain", 0.2, 5.0)
    """Torque over that of the data sheet."""
    gain_sd: float = quantity("gain_sd", 0.0, 1.0)
    drag_nm: float = quantity("drag_nm", -200.0, 200.0)
    drag_sd_nm: float = quantity("drag_sd_nm", 0.0, 200.0)
    touch_pa: float = quantity("touch_bar", 0.0, 2.0, BAR)
    """Gauge pressure at which the pads touch."""
    touch_sd_pa: float = quantity("touch_sd_bar", 0.0, 2.0, BAR)
    sensor_lag_s: float = quantity("sensor_lag_ms", 0.0, 100.0, MS)
    """By how much the measured pressure comes late."""
    sensor_lag_sd_s: float = quantity("sensor_lag_sd_ms", 0.0, 300.0, MS)
    emptying: tuple[float, ...] = quantities("emptying", 0.1, 10.0)
    """Rates of pressure change at the law's knots over those of the data sheet."""
    emptying_sd: tuple[float, ...] = quantities("emptying_sd", 0.0, 2.0)
    """Standard deviations of their logarithms."""
    filling: tuple[float, ...] = quantities("filling", 0.1, 10.0)
    filling_sd: tuple[float, ...] = quantities("filling_sd", 0.0, 2.0)
    off_delay_s: float = quantity("off_delay_ms", 0.0, 200.0, MS)
    off_delay_sd_s: float = quantity("off_delay_sd_ms", 0.0, 100.0, MS)
    on_delay_s: float = quantity("on_delay_ms", 0.0, 200.0, MS)
    on_delay_sd_s: float = quantity("on_delay_sd_ms", 0.0, 100.0, MS)

    KNOTS = 4

    def __post_init__(self) -> None:
        for key in ("emptying", "emptying_sd", "filling", "filling_sd"):
            found = len(getattr(self, key))
            if found != self.KNOTS:
                raise TableError(f"{key} holds {found} numbers, allowed are {self.KNOTS}")


@dataclass(frozen=True)
class NoiseRecord(OfFigures):
    """What the layshaft's model leaves out, and the edges' own scatter. Each sd is that of a
    figure's logarithm."""

    shifts: int = count("learned_from_shifts", 0, MOST_SHIFTS)
    layshaft_edge_s: float = quantity("layshaft_edge_us", 0.05, 500.0, US)
    """Standard deviation of the time of a layshaft edge."""
    layshaft_edge_sd: float = quantity("layshaft_edge_sd", 0.0, 5.0)
    main_edge_s: float = quantity("main_edge_us", 0.05, 500.0, US)
    """Standard deviation of the time of an edge of the main shaft."""
    main_edge_sd: float = quantity("main_edge_sd", 0.0, 5.0)
    torque_nm: float = quantity("torque_nm", 1e-3, 1e3)
    """Standard deviation of the torques at the layshaft that its model leaves out."""
    torque_sd: float = quantity("torque_sd", 0.0, 5.0)
    memory_s: float = quantity("memory_ms", 0.1, 5e3, MS)
    """How long such a torque lasts."""
    memory_sd: float = quantity("memory_sd", 0.0, 5.0)
    friction_nms: float = quantity("friction_nms", 0.0, 10.0, default=0.0)
    """Viscous friction of the layshaft; 0 in a file that was written before it was learned."""
    friction_sd: float = quantity("friction_sd", 0.0, 5.0, default=0.0)


@dataclass(frozen=True)
class SwingRecord(OfFigures):
    """How the driveline swings in one step of the range
    (`controller/estimate/driveline_swing.py`). Each sd is that of a figure's logarithm."""

    shifts: int = count("learned_from_shifts", 1, MOST_SHIFTS)
    natural_rad_s: float = quantity("frequency_hz", 0.01, 1e3, TURN)
    natural_sd: float = quantity("frequency_sd", 0.0, 5.0)
    damping: float = quantity("damping", 1e-4, 1.0)
    """Over the critical one."""
    damping_sd: float = quantity("damping_sd", 0.0, 5.0)
    speed_rad_s: float = quantity("speed_rpm", 1e-4, 1e4, RPM)
    """Standard deviation of the speed when a gear comes out."""
    speed_sd: float = quantity("speed_sd", 0.0, 5.0)
    noise_rad2_s3: float = quantity("noise_rad2_s3", 1e-9, 1e9)
    """Density of the noise that drives the swing."""
    noise_sd: float = quantity("noise_sd", 0.0, 5.0)
    shaft_noise_rad2_s3: float = quantity("shaft_noise_rad2_s3", 1e-9, 1e9)
    """Density of the noise that accelerates the shaft itself."""
    shaft_noise_sd: float = quantity("shaft_noise_sd", 0.0, 5.0)
    hill_rad_s2: float = quantity("hill_rad_s2", 1e-4, 1e5)
    """Standard deviation of the steady acceleration when a gear comes out."""
    hill_sd: float = quantity("hill_sd", 0.0, 5.0)
    has_lash: bool = flag("has_lash")
    """Whether the driveline has shown its backlash."""
    half_lash_rad: float = quantity("half_lash_deg", 1e-5, 90.0, DEG)
    """Half of the driveline's backlash, at the main shaft."""
    half_lash_sd: float = quantity("half_lash_sd", 0.0, 5.0)


@dataclass(frozen=True)
class SwingRecords:
    """By the step of the range."""

    low: SwingRecord | None = group(SwingRecord, default=None)
    high: SwingRecord | None = group(SwingRecord, default=None)


@dataclass(frozen=True)
class SleeveRecord:
    """A sleeve's contacts with one gear (`controller/sleeve/stroke.py`)."""

    delay_s: float = quantity("delay_ms", 1.0, 500.0, MS)
    """From activation to contact, from neutral and at the data sheet's supply pressure."""
    samples: float = quantity("samples", 0.01, 1e4)
    scatter_s: float = quantity("scatter_ms", 1e-3, 100.0, MS)
    scatter_samples: float = quantity("scatter_samples", 0.01, 1e4)


@dataclass(frozen=True)
class SleeveLawRecord:
    """What a sleeve's movements have shown of its law (`controller/sleeve/law.py`). Of two figures
    the first is of the valve that pushes towards the sensor's positive side."""

    movements: int = count("learned_from_movements", 1, MOST_MOVEMENTS)
    on_delay_s: tuple[float, ...] = quantities("on_delay_ms", -100.0, 200.0, MS)
    off_delay_s: tuple[float, ...] = quantities("off_delay_ms", -100.0, 200.0, MS)
    filling: tuple[float, ...] = quantities("filling", 0.01, 100.0)
    """Rate at which a chamber fills, over that of the data sheet."""
    friction: float = quantity("friction", 0.01, 100.0)
    """This and the next three over those of the data sheet."""
    damping: float = quantity("damping", 0.01, 100.0)
    dead_volume: float = quantity("dead_volume", 0.01, 1000.0)
    vent: float = quantity("vent", 0.01, 100.0)
    detent_n: float = quantity("detent_n", -10000.0, 10000.0)
    """Of the detent in neutral. Less than 0: there is none."""
    in_gear_n: float = quantity("detent_in_gear_n", -10000.0, 10000.0)
    offset_m: float = quantity("sensor_offset_mm", -10.0, 10.0, MM)
    gain: float = quantity("sensor_gain", 0.5, 2.0)
    root: tuple[float, ...] = quantities("root_of_covariance", -100.0, 100.0)
    """Cholesky's factor of the errors' covariance, row by row: of delays in s, logarithms, kN, mm
    and again a logarithm, in the order above."""

    UNKNOWNS = 14

    def __post_init__(self) -> None:
        for key, allowed in (
            ("on_delay_s", 2),
            ("off_delay_s", 2),
            ("filling", 2),
            ("root", self.UNKNOWNS * (self.UNKNOWNS + 1) // 2),
        ):
            found = len(getattr(self, key))
            if found != allowed:
                raise TableError(f"{key} holds {found} numbers, allowed are {allowed}")


@dataclass(frozen=True)
class SleeveRecords:
    """The gears into which a sleeve has been seen to go."""

    crawl: SleeveRecord | None = group(SleeveRecord, default=None)
    first: SleeveRecord | None = group(SleeveRecord, default=None)
    second: SleeveRecord | None = group(SleeveRecord, default=None)
    third: SleeveRecord | None = group(SleeveRecord, default=None)

    def of(self, gear: MainGear) -> SleeveRecord | None:
        """The record of a gear."""
        record: SleeveRecord | None = getattr(self, gear.name.lower())
        return record


@dataclass(frozen=True)
class SleeveLawRecords:
    """The sleeves whose law has been learned."""

    first_second: SleeveLawRecord | None = group(SleeveLawRecord, default=None)
    crawl_third: SleeveLawRecord | None = group(SleeveLawRecord, default=None)


@dataclass(frozen=True)
class End:
    """The last lines of a file: one that was cut off before them is torn, wherever it was cut."""

    complete: bool = flag("complete")

    def __post_init__(self) -> None:
        if not self.complete:
            raise TableError("complete = false, allowed is true")


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A whole calibration."""

    format_: int = count("format", CALIBRATION_FORMAT, CALIBRATION_FORMAT)
    provenance: Provenance = group(Provenance)
    wheels: WheelRecords = group(WheelRecords, default=WheelRecords())
    references: ReferenceRecords = group(ReferenceRecords, default=ReferenceRecords())
    brake: BrakeRecord | None = group(BrakeRecord, default=None)
    noise: NoiseRecord | None = group(NoiseRecord, default=None)
    swings: SwingRecords = group(SwingRecords, default=SwingRecords())
    sleeves: SleeveRecords = group(SleeveRecords, default=SleeveRecords())
    sleeve_laws: SleeveLawRecords = group(SleeveLawRecords, default=SleeveLawRecords())
    end: End = group(End)

    def __post_init__(self) -> None:
        wheels = self.wheels
        if self.references.offsets_rad and None in (wheels.layshaft, wheels.main):
            raise TableError("[references] without the teeth of both wheels that they belong to")

    def to_text(self) -> str:
        """The file's content: the same for the same calibration."""
        return to_toml(self, COMMENT)


def read_calibration(content: str, where: str, sheet: GearboxSheet | None) -> Calibration:
    """The calibration in a file's content. CalibrationError names `where`, key, found and allowed.
    Without a sheet, whether it fits one is not asked.

    What is returned is exactly what its own `to_text` gives back, digits beyond those included: a
    run that is repeated from a header starts with the same bits."""
    try:
        calibration = _parsed(content, where)
        if sheet is not None:
            check(calibration, sheet, where)
        return _parsed(calibration.to_text(), where)
    except TableError as error:
        raise CalibrationError(str(error)) from error


def _parsed(content: str, where: str) -> Calibration:
    return read_group(Calibration, parse_toml(content, where), where)


def check(calibration: Calibration, sheet: GearboxSheet, where: str) -> None:
    """TableError where it was learned with another data sheet or does not fit this one."""
    given = calibration.provenance.sheet_sha256
    if given != sheet.sha256:
        allowed = f"allowed is {sheet.sha256[:16]}... of data sheet {sheet.name}"
        raise TableError(f"{where}: provenance: sheet_sha256 = {given[:16]!r}..., {allowed}")
    drawn = {"layshaft": sheet.wheels.layshaft, "main": sheet.wheels.main}
    for field in fields(WheelRecords):
        record: WheelRecord | None = getattr(calibration.wheels, field.name)
        wheel = drawn[field.name]
        if record is None:
            continue
        place = f"{where}: wheels: {field.name}"
        if record.teeth != wheel.teeth:
            raise TableError(f"{place}: teeth = {record.teeth}, allowed is {wheel.teeth}")
        most = PITCH_SHARE * wheel.pitch_rad
        for index, error in enumerate(record.error_rad):
            if abs(error) > most:
                found = f"error_deg[{index}] = {error / DEG:g}"
                raise TableError(f"{place}: {found}, allowed is {most / DEG:.3g} at most")
    least_s = sheet.sleeve.valve_delay_s
    for gear in MAIN_GEARS:
        sleeve = calibration.sleeves.of(gear)
        if sleeve is not None and sleeve.delay_s < least_s:
            found = f"sleeves: {gear.name.lower()}: delay_ms = {sleeve.delay_s / MS:g}"
            raise TableError(
                f"{where}: {found}, allowed is no less than its valve's {least_s / MS:g}"
            )
