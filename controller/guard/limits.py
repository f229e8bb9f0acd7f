"""What the guard holds a command against: the gearbox's own numbers and the limits, SI."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

from meshpoint.controller.settings.settings import ControllerSettings, ValveTiming, splitter_ms
from meshpoint.gearbox import GearboxSheet, MainGear, Range, Split
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN, Sleeve

SPLITTER: Final = 2
"""The number of its sleeve."""
GUARD_NEUTRAL_M: Final = 1.5e-3
"""A main sleeve within this of the middle is proven neutral."""
GUARD_END_M: Final = 1.0e-3
"""A sleeve within this of its end is in."""
CLUTCH_CLOSED_SHARE: Final = 0.98
SLIP_MARGIN_RAD_S: Final = 1.0
"""Error of the measured speeds plus what the vehicle may gain or lose until contact: 10 rpm."""
CLEAR_M: Final = 0.5e-3
"""Teeth this far past each other are out."""
APART_M: Final = 0.2e-3
"""A sleeve that stands this far before the teeth does not touch them: what its sensor may be wrong
by."""
LEAVING_M_S: Final = 0.05
"""A sleeve this fast is on its way, one slower than this over a whole frame stands: some times what
the sensors' noise gives."""
REACT_US: Final = 15_000
"""From a judgement until a command of the next step can take effect: a tick and the bus."""
BUS_US: Final = 5_000
"""The same where the node wakes at the time at which a valve has to switch."""
BRAKE_PRESSED_PA: Final = 1.0e5
"""Above this gauge pressure the brake is taken to put torque on the gear in mesh."""
SPEED_TOLERANCE: Final = 1.01
"""A speed counts as too high when it is more than 1 % above the data sheet's limit."""


class MainValve(NamedTuple):
    """A valve of a sleeve with dog teeth: the sleeve it moves (0 first/second, 1 crawl/third, 2
    splitter), the direction in which it pushes (-1 or +1), and the speed of the gear on that side
    over that of the layshaft."""

    sleeve: int
    direction: int
    ratio: float

    @property
    def meeting(self) -> Meeting:
        """Which shafts meet there: the one that slows down, and the one that another holds."""
        if self.sleeve == SPLITTER:
            return Meeting(0, 1.0, 1, self.ratio)
        return Meeting(1, self.ratio, 2, 1.0)


class Meeting(NamedTuple):
    """Slip = by x the speed of the shaft that falls - over x that of the other. Shafts: 0 input, 1
    layshaft, 2 main shaft."""

    falls: int
    by: float
    holds: int
    over: float


MAIN_VALVE_OF_GEAR: Final = {
    MainGear.FIRST: 3,
    MainGear.SECOND: 4,
    MainGear.CRAWL: 5,
    MainGear.THIRD: 6,
}
"""Repeats the sequence's table on purpose: an error in one table must not disable the guard."""


@dataclass(frozen=True)
class GuardLimits:
    """The limits and the properties of the gearbox that the rules use. SI, but times in us."""

    main: dict[int, MainValve]
    """Main-box valves by their number in the valve frame."""
    split_ratio: dict[int, float]
    """Speed of the layshaft over that of the input shaft, by the splitter sleeve's side: -1 low, +1
    high."""
    range_ratio: dict[int, float]
    """Speed of the propeller shaft over that of the main shaft, by the range sleeve's side."""
    contact_m: float
    sleeve_delay_us: float
    sleeve_valve_us: float
    """From a sleeve valve's activation to the first movement."""
    teeth_out_us: float
    """From there on a main sleeve's teeth may be out of its gear's, at the earliest."""
    stroke_m: float
    clutch_open_share: float
    """The clutch's plates are surely apart from here on."""
    sleeve_scatter_us: float
    switch_again_us: int
    """A main valve that is switched on now can be off again so much later, at the latest."""
    brake_delay_us: tuple[float, float]
    """Of its valve, least and greatest: the sheet's with its tolerance."""
    brake_lag_us: float
    brake_nm_per_pa: float
    atmosphere_pa: float
    face_pulse_us: dict[int, float]
    """The longest pulse of the brake that turns a tooth on which a sleeve stands to the next gap
    within the slip window, by the main valve."""
    brake_rad_s2: tuple[float, float]
    """Deceleration of the layshaft by the full brake, least and most."""
    drag_rad_s2: float
    """Upper bound of the layshaft's deceleration by the drag that does not grow with speed."""
    drag_rate: float
    """Upper bound of the deceleration by viscous drag, divided by the speed, 1/s."""
    slip_rad_s: tuple[float, float]
    input_max_rad_s: float
    main_max_rad_s: float
    brake_on_us: int
    brake_j: float
    brake_floor_rad_s: float
    valve_on_us: int
    before_teeth_us: int
    """A sleeve may stand between neutral and a gear's teeth for so long."""
    supply_low_pa: float
    engaged_m: float
    """From here to its end a sleeve stands in its gear or step."""
    in_mesh_m: float
    """From here to its end a main sleeve surely has its gear's teeth between its own."""
    free_rad: float
    """A gear that has turned against its sleeve by more than this is not in mesh."""
    plate_slip_rad_s: float
    """Most slip over the clutch's plates on which it may close with a gear in."""
    clutch_travel_us: int
    """The clutch's way from one end to the other and back: every shift takes longer."""
    torque_away_us: int
    """For so long the engine's torque may be taken away before the plates have parted."""
    engine_share_s2: float
    """Inertia of the engine over its reference torque: the share of torque that a rad/s2 takes."""
    tick_us: int
    """From one step to the next."""
    closings: int
    """This often the clutch may close without a sleeve being moved in between."""
    closing_again_us: int
    """After so long it may close once more, moved or not."""
    request_us: int
    """A request is answered within this time, or no longer."""
    gear_at: dict[tuple[int, int, int], int]
    """The gear's number by its main valve and the sides of splitter and range sleeve."""
    splitter: dict[int, MainValve] = field(default_factory=dict)
    """The splitter's valves, where its sleeve has dog teeth."""
    input_drag: tuple[float, float] = (0.0, 0.0)
    """What `drag_rad_s2` and `drag_rate` are of an input shaft in no step."""

    @cached_property
    def dogs(self) -> dict[int, MainValve]:
        """The valves of all sleeves with dog teeth."""
        return {**self.main, **self.splitter} if self.splitter else self.main

    @cached_property
    def dog_sleeves(self) -> tuple[int, ...]:
        """Those sleeves by number."""
        return (0, 1, SPLITTER) if self.splitter else (0, 1)

    def drag_of(self, shaft: int) -> tuple[float, float]:
        """Upper bounds of a falling shaft's deceleration by drag: constant, and a rad/s."""
        return (self.drag_rad_s2, self.drag_rate) if shaft else self.input_drag

    @cached_property
    def valve_between_us(self) -> tuple[float, float]:
        """Least and greatest time from a main valve's current to its sleeve's first movement, and
        from the current's end until the chamber is shut off."""
        middle, scatter = self.sleeve_valve_us, self.sleeve_scatter_us
        return max(0.0, middle - scatter), middle + scatter

    @cached_property
    def apart_m(self) -> float:
        """A main sleeve measured within this of the middle touches no gear's teeth."""
        return self.contact_m - APART_M

    @cached_property
    def valves_of(self) -> dict[int, tuple[int, ...]]:
        """The two valves of each sleeve with dog teeth."""
        dogs = self.dogs.items()
        return {
            sleeve: tuple(valve for valve, gear in dogs if gear.sleeve == sleeve)
            for sleeve in self.dog_sleeves
        }

    @property
    def are_sane(self) -> bool:
        """Whether all numbers are finite and positive, and the slip window is not empty."""
        numbers = [
            *(valve.ratio for valve in self.main.values()),
            *self.split_ratio.values(),
            *self.range_ratio.values(),
            self.sleeve_delay_us,
            self.input_max_rad_s,
            self.main_max_rad_s,
            self.brake_rad_s2[1],
            self.brake_j,
            self.valve_on_us,
            self.before_teeth_us,
            self.brake_on_us,
            self.plate_slip_rad_s,
            self.clutch_travel_us,
            self.closings,
            self.closing_again_us,
            self.request_us,
        ]
        return all(math.isfinite(x) and x > 0.0 for x in numbers) and (
            self.slip_rad_s[0] < self.slip_rad_s[1]
        )


def end_of(position_m: float, engaged_m: float) -> int:
    """The end a sleeve stands in, -1 or 1; 0 between."""
    return 0 if abs(position_m) <= engaged_m else 1 if position_m > 0.0 else -1


def guard_limits(sheet: GearboxSheet, settings: ControllerSettings) -> GuardLimits:
    """The limits for a gearbox, from its data sheet and the guard's settings."""
    guard, brake, sleeve = settings.guard, sheet.brake, sheet.sleeve
    inertia = [sheet.inertia_kgm2(split) for split in Split]
    weakest = brake.max_torque_nm / guard.torque_factor / max(inertia)
    strongest = brake.max_torque_nm * guard.torque_factor / min(inertia)
    top = sheet.limits.input_max_rad_s * sheet.split_mesh(Split.HIGH).ratio
    return GuardLimits(
        main={
            valve: MainValve(
                (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD).index(SLEEVE_OF_MAIN[gear].sleeve),
                SLEEVE_OF_MAIN[gear].direction,
                sheet.main_mesh(gear).ratio,
            )
            for gear, valve in MAIN_VALVE_OF_GEAR.items()
        },
        split_ratio={
            -1: sheet.split_mesh(Split.LOW).ratio,
            1: sheet.split_mesh(Split.HIGH).ratio,
        },
        range_ratio={
            -1: sheet.range_mesh(Range.LOW).ratio,
            1: sheet.range_mesh(Range.HIGH).ratio,
        },
        contact_m=sleeve.to_contact_m,
        sleeve_delay_us=sleeve.delay_s * 1e6,
        sleeve_valve_us=sleeve.valve_delay_s * 1e6,
        teeth_out_us=_teeth_out_us(sheet),
        stroke_m=sleeve.stroke_m,
        clutch_open_share=sheet.clutch.surely_open_share,
        sleeve_scatter_us=sleeve.delay_limit_s * 1e6,
        switch_again_us=BUS_US if settings.valve_timing == ValveTiming.IMMEDIATE else REACT_US,
        brake_delay_us=(
            brake.least_valve_delay_s * 1e6,
            brake.greatest_valve_delay_s * 1e6,
        ),
        brake_lag_us=brake.time_constant_s * 1e6,
        brake_nm_per_pa=sheet.brake_nm_per_pa,
        atmosphere_pa=sheet.air.atmosphere_pa,
        face_pulse_us={
            valve: _face_pulse_us(sheet, settings, sheet.main_mesh(gear).ratio * strongest)
            for gear, valve in MAIN_VALVE_OF_GEAR.items()
        },
        brake_rad_s2=(weakest, strongest),
        drag_rad_s2=guard.drag_torque_nm / min(inertia),
        drag_rate=guard.torque_factor * sheet.shafts.friction_nms / min(inertia),
        slip_rad_s=(guard.slip_low_rad_s, guard.slip_high_rad_s),
        input_max_rad_s=SPEED_TOLERANCE * sheet.limits.input_max_rad_s,
        main_max_rad_s=SPEED_TOLERANCE * top * sheet.main_mesh(MainGear.THIRD).ratio,
        brake_on_us=guard.brake_on_ms * 1000,
        brake_j=guard.brake_energy_j,
        brake_floor_rad_s=guard.brake_floor_rad_s,
        valve_on_us=settings.limits.valve_on_ms * 1000,
        before_teeth_us=guard.before_teeth_ms * 1000,
        supply_low_pa=guard.supply_low_pa,
        engaged_m=sleeve.stroke_m - GUARD_END_M,
        in_mesh_m=sleeve.to_contact_m + sheet.dog.most_overlap_m,
        free_rad=sheet.dog.free_rad,
        plate_slip_rad_s=_plate_slip_rad_s(sheet),
        clutch_travel_us=round((sheet.clutch.open_delay_s + sheet.clutch.close_delay_s) * 1e6),
        torque_away_us=1000 * (longest_ramp_ms(settings) + settings.limits.clutch_ms),
        engine_share_s2=(1.0 + sheet.engine.inertia_tolerance)
        * sheet.engine.inertia_kgm2
        / sheet.engine.reference_nm,
        tick_us=settings.timing.tick_us,
        closings=settings.limits.raises + 1,
        closing_again_us=(settings.limits.raise_ms + settings.limits.synchronise_ms) * 1000,
        request_us=longest_shift_us(settings, sheet),
        gear_at={
            (
                MAIN_VALVE_OF_GEAR[gear.main],
                -1 if gear.split is Split.LOW else 1,
                -1 if gear.range_ is Range.LOW else 1,
            ): number
            for number, gear in DRIVE_GEARS.items()
        },
        splitter=_splitter_valves(sheet),
        input_drag=(
            guard.drag_torque_nm / sheet.shafts.input_inertia_kgm2,
            guard.torque_factor * sheet.shafts.friction_nms / sheet.shafts.input_inertia_kgm2,
        ),
    )


def _splitter_valves(sheet: GearboxSheet) -> dict[int, MainValve]:
    if not sheet.has_dog_splitter:
        return {}
    return {
        valve: MainValve(SPLITTER, side, 1.0 / sheet.split_mesh(split).ratio)
        for valve, side, split in ((1, -1, Split.LOW), (2, 1, Split.HIGH))
    }


def _teeth_out_us(sheet: GearboxSheet) -> float:
    """From a pulling valve's activation until the teeth may be out, at the earliest: at the sheet's
    speed all the way, less the delay's scatter."""
    sleeve = sheet.sleeve
    way_s = (sleeve.stroke_m - sleeve.to_contact_m) / sleeve.speed_m_s
    return 1e6 * max(sleeve.valve_delay_s, sleeve.valve_delay_s + way_s - sleeve.delay_limit_s)


def _face_pulse_us(sheet: GearboxSheet, settings: ControllerSettings, full_rad_s2: float) -> float:
    """The longest pulse of the brake on a tooth that stands on a tooth. full_rad_s2: what the full
    brake takes of the gear's speed.

    From rest, but for what speeds may be wrong by, no gear gets beyond v^2 = v0^2 + 2 a s within
    the width s of a face, where a gap comes by. The brake never has more than the pressure at the
    pulse's end, filled at the sheet's fastest; before, it had no more than counts as released. The
    last of it is out after some time constants, so a pulse is no longer than one."""
    brake, dog = sheet.brake, sheet.dog
    face_rad = dog.pitch_rad - dog.backlash_rad
    most_rad_s = SLIP_MARGIN_RAD_S - settings.guard.slip_low_rad_s
    most_rad_s2 = (most_rad_s**2 - SLIP_MARGIN_RAD_S**2) / (2.0 * face_rad)
    empty = 1.0 - BRAKE_PRESSED_PA / sheet.air.supply_gauge_pa
    left = max(0.0, 1.0 - most_rad_s2 / full_rad_s2)
    fast_s = brake.time_constant_s * (1.0 - brake.time_constant_tolerance)
    filled_s = fast_s * math.log(empty / left) if left > 0.0 else math.inf
    scatter_s = brake.greatest_valve_delay_s - brake.least_valve_delay_s
    return 1e6 * max(0.0, min(filled_s, fast_s) - scatter_s)


def _plate_slip_rad_s(sheet: GearboxSheet) -> float:
    """What the closest step of the main box leaves over the plates at the input shaft's limit,
    where the engine keeps its speed. A wider step waits until the engine has come down."""
    ratios = sorted(sheet.main_mesh(gear).ratio for gear in MAIN_VALVE_OF_GEAR)
    step = min(high / low for low, high in itertools.pairwise(ratios))
    return sheet.limits.input_max_rad_s * (1.0 - 1.0 / step)


def longest_ramp_ms(settings: ControllerSettings) -> int:
    """How long a shift's torque ramp may take, ms."""
    return settings.engine.swing_ramp_ms + settings.engine.ramp_ms


def longest_shift_us(settings: ControllerSettings, sheet: GearboxSheet) -> int:
    """No shift takes longer: every phase as long as its limit, every retry used."""
    limits = settings.limits
    raised_ms = limits.raise_ms + limits.clutch_ms + 2 * limits.synchronise_ms
    tried_ms = limits.engage_ms + 2 * limits.disengage_ms
    return 1000 * (
        longest_ramp_ms(settings)
        + limits.clutch_ms
        + limits.steps_ms
        + (limits.raises + 1) * raised_ms
        + limits.attempts * tried_ms
        + (splitter_ms(settings) if sheet.has_dog_splitter else 0)
    )
