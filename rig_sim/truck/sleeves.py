"""The main sleeves of the truck along their axis.

As `sleeves` has it, and beyond:

* APPROACH takes the delay law or the cylinder's own time; contact is met with a speed.
* ENTER goes on by force against mass and damping. It may be thrown back before the overlap that
  holds is reached: EJECTED, to FACE, at rest.
* RETRACT out of a loaded flank waits, while friction and back taper hold more than the force:
  F < (mu + tan beta) |T| / r.
* A jammed sleeve stays where it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshpoint.gearbox.sheet import SleeveActuator
from meshpoint.rig_sim.shared.sleeves import (
    NEVER_US,
    SleeveAxis,
    SleeveEvent,
    SleeveState,
    Stroke,
    resting,
)
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.strokes import Push, PushedStroke, SampledStroke
from meshpoint.units import MM, SECOND_US


class Axial(NamedTuple):
    """What the as-built sleeve has along its axis."""

    by_force: bool
    mass_kg: float
    force_n: float
    damping_nsm: float
    friction_n: float
    overlap_m: float
    hold_per_nm: float
    """Axial force that friction and back taper hold, per Nm of torque at the flank."""


def axial(built: AsBuilt, radius_m: float) -> Axial:
    """From the as-built parameters."""
    taper = math.tan(math.radians(built["sleeve.back_taper_deg"]))
    return Axial(
        built["sleeve.entry_law"] >= 0.5,
        built["sleeve.mass_kg"],
        built["sleeve.force_n"],
        built["sleeve.damping_nsm"],
        built["sleeve.friction_n"],
        built["dog.overlap_mm"] * MM,
        (built["sleeve.flank_friction"] + taper) / radius_m,
    )


class TruckSleeve(SleeveAxis):
    """One main sleeve."""

    def __init__(self, actuator: SleeveActuator, engaged_side: int, axis: Axial) -> None:
        super().__init__(actuator, engaged_side)
        self.axis = axis
        self.overlap_us = NEVER_US
        self.unload_us = NEVER_US
        self.force_n = axis.force_n
        self.speed_m_s = 0.0
        self.jammed = False
        self._release_s = 0.0

    @property
    def next_us(self) -> float:
        """When contact, overlap, the start or end of a release, or neutral is due."""
        return min(
            self.contact_us, self.unmesh_us, self.neutral_us, self.overlap_us, self.unload_us
        )

    @property
    def net_force_n(self) -> float:
        """Force less the seals' friction."""
        return max(self.force_n - self.axis.friction_n, 0.0)

    def approach(self, stroke: SampledStroke, side: int, speed_m_s: float) -> None:
        """The valve towards a gear is energised: the cylinder's stroke."""
        self._go(SleeveEvent.ENGAGE)
        self.side = side
        self.contact_us = stroke.end_us
        self.speed_m_s = speed_m_s
        self._move(stroke)

    def engage(self, time_us: float, side: int, delay_s: float) -> None:
        """The same by the delay law: contact comes exactly delay_s later."""
        super().engage(time_us, side, delay_s)
        moving_s = delay_s - self._actuator.valve_delay_s
        self.speed_m_s = 2.0 * self._actuator.to_contact_m / moving_s

    def enter(self, time_us: float) -> None:
        """The gear's tooth stands in the gap: on to full stroke, from the present speed."""
        if not self.axis.by_force:
            super().enter(time_us)
            way_m = self.axis.overlap_m
            self.overlap_us = time_us + way_m / self._actuator.speed_m_s * SECOND_US
            return
        speed = self.speed_m_s if self.state is SleeveState.APPROACH else 0.0
        self._go(SleeveEvent.IN_GAP)
        self.contact_us = NEVER_US
        push = Push(self.net_force_n, self.axis.mass_kg, self.axis.damping_nsm, speed)
        self._push_in(time_us, push)
        self.overlap_us = time_us + push.time_s(self.axis.overlap_m) * SECOND_US

    def overlapped(self) -> None:
        """The overlap that holds has been reached."""
        self.overlap_us = NEVER_US

    def eject(self, time_us: float) -> None:
        """A flank met before the overlap holds: back onto the face, at rest."""
        self._go(SleeveEvent.EJECTED)
        self.overlap_us = NEVER_US
        self._move(resting(time_us, self._actuator.to_contact_m))

    def release(self, time_us: float, delay_s: float) -> None:
        """The opposite valve is energised: after the valve's delay the sleeve wants to go."""
        if self.state is not SleeveState.LOCKED:
            super().release(time_us, delay_s)
            self.overlap_us = NEVER_US
            return
        self._go(SleeveEvent.RELEASE)
        self._release_s = delay_s - self._actuator.valve_delay_s
        self.unload_us = time_us + self._actuator.valve_delay_s * SECOND_US
        self._move(resting(time_us, abs(self.position_m(time_us))))

    def go(self, time_us: float) -> None:
        """Nothing holds the sleeve any more: out of mesh and to neutral."""
        from_m = abs(self.position_m(time_us))
        self.unload_us = NEVER_US
        self.neutral_us = time_us + self._release_s * SECOND_US
        share = math.sqrt(1.0 - min(self._actuator.to_contact_m / from_m, 1.0))
        self.unmesh_us = time_us + share * (self.neutral_us - time_us)
        self._move(Stroke(time_us, time_us, self.neutral_us, from_m, 0.0, 2))

    def wait(self) -> None:
        """Friction and back taper hold the sleeve: until `go`."""
        self.unload_us = NEVER_US

    @property
    def waits(self) -> bool:
        """Whether a release has been asked for and is held by the torque."""
        return (
            self.state is SleeveState.RETRACT
            and self.neutral_us == NEVER_US
            and self.unload_us == NEVER_US
        )

    @property
    def meshed(self) -> bool:
        """Whether the teeth of gear and sleeve overlap."""
        return super().meshed or self.waits or self.unload_us < NEVER_US

    def let_go(self, time_us: float) -> None:
        """The valve towards the gear is off before anything holds the sleeve."""
        super().let_go(time_us)
        self.overlap_us = NEVER_US

    def hold(self, time_us: float) -> None:
        """The release is given up while the teeth still overlap: back to full stroke."""
        self.unload_us = NEVER_US
        super().hold(time_us)

    def _push_in(self, time_us: float, push: Push) -> None:
        from_m = abs(self.position_m(time_us))
        to_m = self._actuator.stroke_m
        end_us = time_us + push.time_s(to_m - from_m) * SECOND_US
        self._move(PushedStroke(time_us, end_us, from_m, to_m, push))
