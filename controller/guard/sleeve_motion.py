"""How soon a main sleeve can meet its gear, and how long its valve may be on for it to stop short:
bounds from the data sheet, and what of a sleeve's driving still works on.

A chamber's pressure grows evenly, so that the way goes with the cube of the time: an eighth of the
way takes half of it. The fastest sleeve has the sheet's least delay, of which all that is early is
taken to be a stronger push.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.controller.guard.limits import CLEAR_M, GuardLimits

BREAKAWAY_SHARE: Final = 1.0 / 3.0
"""Of the slowest stroke's time this much goes by, however short the way, until the pressure is
above the friction."""
RUN_ON: Final = 2.0
"""Once its valve is off, a sleeve runs on no further than if the valve had been on for this many
times as long: friction stops it before the chamber has vented."""


def contact_between_us(
    limits: GuardLimits, start_us: float, least_m: float, most_m: float
) -> tuple[float, float]:
    """Earliest and latest time (us) at which a sleeve meets its gear whose valve is on from
    `start_us`, and that stands between `least_m` and `most_m` then, positive toward the gear."""
    fast_us, slow_us = limits.valve_between_us
    early_us = limits.sleeve_delay_us - limits.sleeve_scatter_us - fast_us
    late_us = limits.sleeve_delay_us + limits.sleeve_scatter_us - slow_us
    late_share = BREAKAWAY_SHARE + (1.0 - BREAKAWAY_SHARE) * _share_of_time(limits, least_m)
    return (
        start_us + fast_us + early_us * _share_of_time(limits, most_m),
        start_us + slow_us + late_us * late_share,
    )


def longest_pulse_us(limits: GuardLimits, way_m: float) -> float:
    """For so long a valve may be on, and its sleeve, which stands at `way_m` (positive toward this
    valve's gear), surely stops short of that gear's teeth: by CLEAR_M."""
    stroke_us = limits.sleeve_delay_us - limits.sleeve_scatter_us - limits.sleeve_valve_us
    clear_m = max(0.0, limits.contact_m - CLEAR_M - way_m)
    return float(stroke_us / RUN_ON * (clear_m / limits.contact_m) ** (1.0 / 3.0))


def _share_of_time(limits: GuardLimits, stands_m: float) -> float:
    """Of the time from neutral to contact: that of a sleeve that begins at `stands_m`."""
    share = (limits.contact_m - stands_m) / limits.contact_m
    return float(min(1.0, max(0.0, share)) ** (1.0 / 3.0))


class Drive(NamedTuple):
    """A main valve was on, more than once perhaps, since its sleeve was last seen to stand."""

    start_us: int
    end_us: int
    engages: bool
    """Whether it drove the sleeve to a gear's teeth, as far as the guard could tell."""
    pulls: bool
    """Whether it pulled a gear out."""
    driven_us: int
    """How long it was on in all."""
    stood_m: float
    """Where the sleeve stood as it set it going, positive toward the valve's gear."""

    def ending_at(self, end_us: int) -> Drive:
        """As long a one by another clock."""
        return self._replace(start_us=end_us - self.lasted_us, end_us=end_us)

    @property
    def lasted_us(self) -> int:
        """From the first valve's current to the end of the last."""
        return self.end_us - self.start_us
