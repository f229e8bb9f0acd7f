"""The controller's sleeves against one drawn sleeve, in steps of 10 ms."""

from __future__ import annotations

from drawn_sleeve import FACE, DrawnSleeve

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.settings.valve_name import OPPOSITE, SLEEVE_VALVE
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.dbc.messages import SleevesMain
from meshpoint.gearbox import GearboxSheet, MainGear, Sleeve

TICK_US, IN_GEAR = 10_000, 11e-3
GEAR, OTHER = MainGear.SECOND, MainGear.FIRST
SLEEVE = Sleeve.FIRST_SECOND
VALVES = (SLEEVE_VALVE[GEAR], SLEEVE_VALVE[OTHER])


class SleeveBench:
    """Room and sleeve, and the time of both."""

    def __init__(self, sheet: GearboxSheet, sleeve: DrawnSleeve) -> None:
        self.sleeves, self.sleeve = Sleeves(sheet), sleeve
        self.view = GearboxView(sheet)
        self.now_us = 0
        self.back_us = 0
        """By so much the sensors' clock, which the room goes by, was set back."""
        self.run(200_000)

    def command(self, valve: int, on: bool, time_us: int) -> None:
        """To the valve and to the room."""
        self.sleeve.command(valve, on, time_us)
        self.sleeves.expected(VALVES[valve], [(time_us - self.back_us, on)])

    def step(self) -> None:
        """Ten milliseconds more."""
        samples = []
        for k in range(1, 11):
            self.sleeve.advance(self.now_us + 1_000 * k)
            samples.append(self.sleeve.reading_m())
        self.now_us += TICK_US
        message = SleevesMain(0, 0, tuple(reversed(samples)), (0.0,) * 10)
        sensor_us = self.now_us - self.back_us
        self.view.sleeves_main(message, sensor_us)
        self.sleeves.take(self.view, sensor_us + 2_000)

    def run(self, by_us: int) -> None:
        """So much longer, in whole steps."""
        for _ in range(by_us // TICK_US):
            self.step()

    def pulse(self, valve: int, on_us: int, off_us: int) -> None:
        """A valve on, then off; the second is commanded when the first has passed."""
        self.command(valve, True, on_us)
        while self.now_us + 2_000 < on_us:
            self.step()
        self.command(valve, False, off_us)
        while self.now_us < off_us:
            self.step()

    def fire(self, way: int = 0) -> tuple[float, float]:
        """A stroke into the gear: its predicted and its true contact, us after the coil."""
        gear = GEAR if way == 0 else OTHER
        fire_us = self.now_us + 15_000
        predicted = self.sleeves.stroke(gear, fire_us - self.back_us)
        self.sleeve.reached_us.clear()
        self.command(way, True, fire_us)
        self.run(150_000)
        face = FACE if way == 0 else -FACE
        return predicted.contact_us - fire_us + self.back_us, self.sleeve.reached_us[face] - fire_us

    def back(self, way: int = 0) -> float:
        """Out of the gear and to neutral by the room's own pulses; where the one left it that took
        it out of the gear."""
        self.command(way, False, self.now_us + 4_000)
        self.run(1_000_000)
        gear, pulls = GEAR if way == 0 else OTHER, 0
        while abs(self.sleeve.x) > IN_GEAR:
            assert pulls < 8
            on_us = self.now_us + 15_000
            pulse = self.sleeves.pull_out(gear, on_us - self.back_us, pulls)
            self.pulse(1 - way, on_us, pulse.off_us + self.back_us)
            self.run(300_000)
            pulls += 1
        first_m = self.sleeve.x
        for _ in range(6):
            on_us = self.now_us + 15_000
            again = self.sleeves.to_neutral(SLEEVE, on_us - self.back_us)
            if again is None:
                break
            self.pulse(VALVES.index(again.valve), on_us, again.off_us + self.back_us)
            self.run(300_000)
        return first_m


__all__ = ["GEAR", "OPPOSITE", "OTHER", "SLEEVE", "SleeveBench"]
