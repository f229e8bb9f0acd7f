"""The main sleeves of the truck by a pure delay (`sleeve.model` 0; as built: `driven_sleeve`).

As `shared.sleeves` has it, and beyond:

* ENTER may be bounced off before the overlap that holds is reached: EJECTED, to FACE, at rest.
* RETRACT out of a loaded flank waits, while friction and back taper hold more than the force:
  F < (mu + tan beta) |T| / r.
* A jammed sleeve stays where it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from meshpoint.gearbox.sheet import SleeveActuator
from meshpoint.rig_sim.shared.sleeves import (
    NEVER_US,
    MainSleeve,
    SleeveAxis,
    SleeveEvent,
    SleeveState,
    Stroke,
    resting,
)
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.units import MM, SECOND_US


class Axial(NamedTuple):
    """What the as-built sleeve has along its axis."""

    force_n: float
    friction_n: float
    overlap_m: float
    hold_per_nm: float
    """Axial force that friction and back taper hold, per Nm of torque at the flank."""


def axial(built: AsBuilt, radius_m: float) -> Axial:
    """From the as-built parameters."""
    taper = math.tan(math.radians(built["sleeve.back_taper_deg"]))
    return Axial(
        built["sleeve.force_n"],
        built["sleeve.friction_n"],
        built["dog.overlap_mm"] * MM,
        (built["sleeve.flank_friction"] + taper) / radius_m,
    )


class TruckSleeve(MainSleeve, Protocol):
    """What teeth and bench do to a main sleeve of the truck, however it moves."""

    is_shallow: bool
    """In the gap, but not yet by the overlap that holds."""
    jammed: bool

    def pressing_n(self, time_us: float) -> float:
        """Force on the tooth it stands before, the seals' friction off."""

    def rest_on_tooth(self, time_us: float) -> None:
        """Contact, tooth on tooth."""

    def enter(self, time_us: float) -> None:
        """The gear's tooth stands in the gap: on to full stroke."""

    def eject(self, time_us: float) -> None:
        """A flank met before the overlap holds: back onto the face, at rest."""

    def lock(self) -> None:
        """The tooth is at the flank."""

    def unmesh(self) -> None:
        """The teeth have left each other."""

    def jam(self, time_us: float, jammed: bool) -> None:
        """No activation moves it from now on, or again."""


class DelayedSleeve(SleeveAxis):
    """One main sleeve by a pure delay."""

    def __init__(self, actuator: SleeveActuator, engaged_side: int, axis: Axial) -> None:
        super().__init__(actuator, engaged_side)
        self.axis = axis
        self.overlap_us = NEVER_US
        self.unload_us = NEVER_US
        self.force_n = axis.force_n
        self.is_shallow = False
        """In the gap, but not yet by the overlap that holds."""
        self.jammed = False
        self._release_s = 0.0

    @property
    def next_us(self) -> float:
        """When contact, overlap, the start or end of a release, or neutral is due."""
        return min(
            self.contact_us, self.unmesh_us, self.neutral_us, self.overlap_us, self.unload_us
        )

    def pressing_n(self, time_us: float) -> float:  # noqa: ARG002
        """Force on the tooth it stands before, the seals' friction off."""
        return max(self.force_n - self.axis.friction_n, 0.0)

    def enter(self, time_us: float) -> None:
        """The gear's tooth stands in the gap: on to full stroke."""
        super().enter(time_us)
        self.is_shallow = True
        self.overlap_us = time_us + self.axis.overlap_m / self._actuator.speed_m_s * SECOND_US

    def jam(self, time_us: float, jammed: bool) -> None:  # noqa: ARG002
        """Activations do not move it from now on, or do so again."""
        self.jammed = jammed

    def overlapped(self) -> None:
        """The overlap that holds has been reached."""
        self.overlap_us, self.is_shallow = NEVER_US, False

    def eject(self, time_us: float) -> None:
        """A flank met before the overlap holds: back onto the face, at rest."""
        self._go(SleeveEvent.EJECTED)
        self.overlapped()
        self._move(resting(time_us, self._actuator.to_contact_m))

    def release(self, time_us: float, delay_s: float) -> None:
        """The opposite valve is energised: after the valve's delay the sleeve wants to go."""
        if self.state is not SleeveState.LOCKED:
            super().release(time_us, delay_s)
            self.overlapped()
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
        self.overlapped()

    def hold(self, time_us: float) -> None:
        """The release is given up before the sleeve has moved: on to full stroke."""
        self.unload_us = NEVER_US
        super().hold(time_us)
