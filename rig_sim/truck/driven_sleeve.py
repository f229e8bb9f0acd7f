"""A main sleeve that air drives: where it is between its gears, over the motion of its cylinder.

* NEUTRAL: it stands between its gears, wherever friction and the detent have left it.
* APPROACH: it moves away from neutral, towards `side`; RETRACT: towards neutral.
* FACE: it is pressed on a tooth, or has no force yet; it leaves it when it is pulled away.
* ENTER, LOCKED: in mesh. Out of a loaded flank it waits while friction and back taper hold more
  than the force: F < (mu + tan beta) |T| / r. Once it moves it is in RETRACT.

Both valves act at any time, in either direction, alone or together.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.gearbox.sheet import SleeveActuator
from meshpoint.rig_sim.parts.cylinder import Cylinder
from meshpoint.rig_sim.shared.sleeves import NEVER_US, SleeveState
from meshpoint.rig_sim.truck.axial_motion import AxialMotion
from meshpoint.rig_sim.truck.sleeves import Axial

PRESS_US: Final = 1_000.0
"""At this interval what rubs or waits gets the force anew, its mean until then, while air flows."""
SUPPLY_US: Final = 10_000.0
"""And at this one an open spool the tank's pressure."""


class Spool(NamedTuple):
    """A spool on its way, after its coil: when it switches, and when it would without chance."""

    due_us: float
    side: int
    """To which it pushes the sleeve."""
    on: bool
    expected_us: float


class DrivenSleeve:
    """One main sleeve between two chambers."""

    def __init__(
        self, actuator: SleeveActuator, engaged_side: int, axis: Axial, cylinder: Cylinder
    ) -> None:
        self._actuator = actuator
        self.axis = axis
        self.side = engaged_side
        self.state = SleeveState.LOCKED if engaged_side else SleeveState.NEUTRAL
        self.is_shallow = False
        """In the gap, but not yet by the overlap that holds."""
        self.jammed = False
        self._in_mesh = engaged_side != 0
        self.cylinder = cylinder.copy()
        """Its own: friction, supply and spools are set here, then `go_on`."""
        self.motion = AxialMotion(self.cylinder, engaged_side * actuator.stroke_m)
        self.look_us = NEVER_US
        self.spools: list[Spool] = []
        """Those on their way, the next one first."""

    @property
    def next_us(self) -> float:
        """When something happens on the axis, a spool switches, or the force is due anew."""
        spool_us = self.spools[0].due_us if self.spools else NEVER_US
        return min(self.motion.end_us, spool_us, self.look_us)

    @property
    def meshed(self) -> bool:
        """Whether the teeth of gear and sleeve overlap."""
        return self._in_mesh

    @property
    def waits(self) -> bool:
        """Whether the torque at the flank holds it against the air."""
        return self.cylinder.held != 0

    @property
    def stroke_end_us(self) -> float:
        """Since ever, where it is at full stroke; else not known."""
        full_m = self.side * self._actuator.stroke_m
        return 0.0 if self.motion.stands_at_m == full_m else NEVER_US

    def position_m(self, time_us: float) -> float:
        """Signed distance from neutral, at most 10 ms before the newest change."""
        return self.motion.position_m(time_us)

    def moves_after(self, time_us: float) -> bool:
        """Whether the position at or after that instant may differ from the present one."""
        return self.motion.moves_after(time_us)

    def force_at_n(self, time_us: float, direction: int) -> float:
        """What presses it that way, friction off; the mean from now until it is asked for anew."""
        until_us = min(time_us + PRESS_US, self.motion.end_us)
        pushes = (self.motion.push_at_n(time_us), self.motion.push_at_n(until_us))
        return sum(max(direction * n - self.cylinder.sliding_n, 0.0) for n in pushes) / 2.0

    def pressing_n(self, time_us: float) -> float:
        """Force on the tooth it stands before."""
        return self.force_at_n(time_us, self.side)

    @property
    def fed(self) -> bool:
        """Whether a chamber is open to the tank, by its valve or by a leak."""
        c = self.cylinder
        leaks = c.a_leak_m3_spa > 0.0 or c.b_leak_m3_spa > 0.0
        return leaks or c.a_on != 0 or c.b_on != 0

    def look_again(self, time_us: float) -> None:
        """When force and supply are wanted next."""
        wanted = self.state is SleeveState.FACE or self.waits
        if wanted and not self.motion.rests(time_us):
            self.look_us = time_us + PRESS_US
        else:
            self.look_us = time_us + SUPPLY_US if self.fed else NEVER_US

    def spool(self, time_us: float, side: int, on: bool) -> None:
        """The spool of the valve that pushes to this side has switched."""
        self.motion.cut(time_us)
        if side > 0:
            self.cylinder.a_on = int(on)
        else:
            self.cylinder.b_on = int(on)
        self.cylinder.held = 0
        self.go_on(time_us)

    def go_on(self, time_us: float) -> None:
        """Integrate from here on, with what stands in its way in its present state."""
        self.motion.cut(time_us)
        self._set_bounds()
        self.motion.run(time_us)
        self.look_again(time_us)

    def rest_on_tooth(self, time_us: float) -> None:
        """Contact, tooth on tooth."""
        self.state = SleeveState.FACE
        self.motion.cut(time_us)
        self.motion.stop()
        self.go_on(time_us)

    def enter(self, time_us: float) -> None:
        """The gear's tooth stands in the gap: nothing is in its way up to full stroke."""
        self.state, self._in_mesh = SleeveState.ENTER, True
        self.is_shallow = self.axis.overlap_m > 0.0
        self.go_on(time_us)

    def eject(self, time_us: float) -> None:
        """A flank met before the overlap holds: back onto the face, at rest."""
        self.state, self._in_mesh, self.is_shallow = SleeveState.FACE, False, False
        self.motion.cut(time_us)
        self.motion.place(self.side * self._actuator.to_contact_m)
        self.go_on(time_us)

    def lock(self) -> None:
        """The tooth is at the flank."""
        self.state = SleeveState.LOCKED

    def wait(self) -> None:
        """Friction and back taper hold the sleeve: until `go`."""
        self.motion.stop()
        self.cylinder.held = -self.side

    def go(self, time_us: float) -> None:
        """The torque holds the sleeve no more."""
        self.state = SleeveState.RETRACT
        self.pull_no_more(time_us)

    def unmesh(self) -> None:
        """The teeth have left each other."""
        self._in_mesh, self.is_shallow, self.cylinder.held = False, False, 0
        self.state = SleeveState.RETRACT

    def pull_no_more(self, time_us: float) -> None:
        """A sleeve that waits is no longer pulled, or no longer held."""
        self.motion.cut(time_us)
        self.cylinder.held = 0
        self.go_on(time_us)

    def set_out(self, direction: int) -> None:
        """It begins to move between its gears, or passes neutral."""
        x_m = self.cylinder.y.x_m
        away = x_m * direction >= 0.0
        self.side = direction if away else -direction
        self.state = SleeveState.APPROACH if away else SleeveState.RETRACT

    def stand(self) -> None:
        """It has come to a stop."""
        if not self._in_mesh:
            self.state, self.side = SleeveState.NEUTRAL, 0
        elif self.state is SleeveState.RETRACT:
            self.state = SleeveState.LOCKED

    def jam(self, time_us: float, jammed: bool) -> None:
        """It is stuck where it is, or no more."""
        self.motion.cut(time_us)
        self.jammed = jammed
        if jammed:
            self.motion.stop()
            self.stand()
        self.cylinder.jammed = int(jammed)
        self.go_on(time_us)

    def script_to_neutral(self, time_us: float, duration_s: float) -> None:
        """The bench moves it to neutral, within this time, its chambers vented."""
        self.spools.clear()
        face_m = self.side * self._actuator.to_contact_m
        stops_m = (face_m, 0.0) if self._in_mesh else (0.0,)
        self.state = SleeveState.RETRACT
        self.motion.script(time_us, stops_m, duration_s)
        self.cylinder.held = 0
        self.look_us = NEVER_US

    def _set_bounds(self) -> None:
        c, sheet, side = self.cylinder, self._actuator, self.side
        x_m, face_m = c.y.x_m, sheet.to_contact_m
        c.walled = 0
        if self._in_mesh:
            full_m = face_m + self.axis.overlap_m if self.is_shallow else sheet.stroke_m
            c.walled = 0 if self.is_shallow else side
            c.low_m, c.high_m = (face_m, full_m) if side > 0 else (-full_m, -face_m)
            return
        c.high_m = 0.0 if x_m < 0.0 else face_m
        c.low_m = 0.0 if x_m > 0.0 else -face_m
        if self.state is SleeveState.FACE:
            c.walled = side
