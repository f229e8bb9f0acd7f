"""A controller of your own against the rig: it shifts 8 -> 10 as simply as it goes.

    python examples/own_controller.py

It opens the clutch, pulls the sleeve out, brakes the layshaft until the slip is small, and fires
into the new gear without looking where the teeth are. It has no guard and no plan for faults; all
of that is in the folder controller/.
"""

import meshpoint
from meshpoint import messages as m
from meshpoint.dbc.node import Node
from meshpoint.gearbox import MainGear

NEEDED = {m.SleevesMain, m.EdgesLayshaftRise, m.EdgesMainRise, m.GearboxSensors}


class SpeedWindow:
    """A `meshpoint.Core`: frames in, frames out, a step every 10 ms."""

    def __init__(self, sheet):
        self.sheet, self.next_step_us, self.steps, self.seen = sheet, 0, 0, {}
        self.receiver = meshpoint.Receiver(Node.TRANSMISSION_CONTROL)
        self.transmitter = meshpoint.Transmitter(Node.TRANSMISSION_CONTROL)
        self.gear, self.start_us, self.fire_us = 8, 0, 0

    def receive(self, frame):
        message = self.receiver.receive(frame).message
        self.seen[type(message)] = message

    def turns_s(self, kind, wheel):
        """Turns a second of a shaft, over its last nine teeth."""
        stamps = self.seen[kind].timestamp_low_us
        return 9e6 / wheel.teeth / ((stamps[0] - stamps[9]) % 65536)

    def slip_rpm(self):
        """How much faster the gear wheel of 10 turns than the main shaft with its sleeve."""
        ratio, wheels = self.sheet.main_mesh(MainGear.SECOND).ratio, self.sheet.wheels
        layshaft = self.turns_s(m.EdgesLayshaftRise, wheels.layshaft)
        return 60 * (ratio * layshaft - self.turns_s(m.EdgesMainRise, wheels.main))

    def valves(self, at_m, now_us):
        """Out of gear 8, brake, into gear 10: what the sleeve's place and the slip ask for."""
        if at_m < -1e-3 or self.fire_us:  # the valve that pulls out of 8 is that which fires 10
            return m.ValveCommand(main_second_action=m.ValveAction.ON_NOW)
        slip_rpm, clutch = self.slip_rpm(), self.seen[m.GearboxSensors].clutch_position_fraction
        if clutch > 0.1 or slip_rpm > 250:  # a released brake goes on for a while
            return m.ValveCommand(brake_action=m.ValveAction(clutch <= 0.1))
        self.fire_us = now_us if slip_rpm < 30 else 0
        return m.ValveCommand()

    def step(self, now_us):
        self.next_step_us, self.steps, sent = now_us + 10_000, self.steps + 1, []
        clutch, valves = m.ClutchAction.CLOSE, m.ValveCommand()
        if self.seen.keys() >= NEEDED:
            sleeves, asked = self.seen[m.SleevesMain], self.seen.pop(m.TC1, None)
            at_m, clock_us = sleeves.sleeve_first_second_m[0], sleeves.sample_time_us
            if abs(at_m) > 0.95 * self.sheet.sleeve.stroke_m:
                self.gear = 8 if at_m < 0 else 10
            if asked and asked.requested_gear == 10 and self.gear == 8 and not self.start_us:
                self.start_us, self.fire_us = clock_us, 0
            if self.start_us and self.gear == 8:
                clutch, valves = m.ClutchAction.OPEN, self.valves(at_m, clock_us)
            elif self.start_us:
                sent, self.start_us = [self.outcome(clock_us)], 0
        state = m.ControllerState.SYNCHRONISING if self.start_us else m.ControllerState.IN_GEAR
        status = m.ControllerStatus(self.steps, now_us, state=state, current_gear=self.gear)
        sent = [m.ClutchCommand(clutch), valves, *sent, status]
        return meshpoint.Step([self.transmitter.encode(message) for message in sent], [])

    def outcome(self, end_us):
        """Engaged: what the bench and everybody's statistics want to know of the shift."""
        return m.ShiftOutcome(
            8, 10, result=m.ShiftResult.ENGAGED, attempts=1, fire_time_us=self.fire_us,
            request_time_us=self.start_us, end_time_us=end_us,
        )  # fmt: skip

    def shutdown(self, now_us):
        return meshpoint.Step([self.transmitter.encode(m.ValveCommand())], [])


if __name__ == "__main__":
    sheet = meshpoint.load_gearbox("thesis")
    with meshpoint.Bench(controller=SpeedWindow(sheet), gearbox=sheet, preset="thesis") as bench:
        for _ in range(5):
            row = bench.shift(10, from_gear=8)
            print(f"{row.result} after {row.duration_ms:.0f} ms, tooth met {row.contact}")
