"""The five bodies and their links: groups of rigidly linked bodies, and impacts between them.

An impact at a link with ratio i (speed behind over speed before), slip s = i w_before - w_behind:

    J_eq = 1 / (i^2 / J_before + 1 / J_behind)
    impulse J_eq (1 + e) s,  loss J_eq s^2 (1 - e^2) / 2

on the groups' inertias felt at the link. A body whose speed the bench gives has infinite inertia.
"""

from __future__ import annotations

import ctypes
from typing import Any, Final, NamedTuple, cast

from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.driveline import longest_step_us
from meshpoint.rig_sim.truck.layout import Rig

UNLIMITED: Final = float("inf")
MOST_KNOWN: Final = 64
"""Links and accelerations kept; the bench prescribes another acceleration each time."""


class _Linked(NamedTuple):
    """What follows from the links and the prescribed accelerations. Teeth that rattle come back to
    the same two over and over, so it is kept."""

    bodies: bytes
    """All of `Connections.bodies`."""
    swing_us: float
    led: tuple[tuple[int, float, int], ...]
    """Body, speed over that of its leader, leader; leaders left out."""
    felt: dict[int, tuple[float, dict[int, float]]]
    """What `_feel` has found."""


class BodyChain:
    """Which of the five bodies are linked. Works in place on the rig's state and connections."""

    def __init__(self, rig: Rig) -> None:
        self._p, self._y, self._g = rig.p, rig.y, rig.g
        self._ratios: list[float | None] = [None] * at.LINKS
        self._forced: dict[int, float] = {}
        self._known: dict[tuple[float | None, ...], _Linked] = {}
        self._felt: dict[int, tuple[float, dict[int, float]]] = {}
        for link in range(at.LINKS):
            self._limit(link, -UNLIMITED, UNLIMITED)
        self._relink()

    def is_rigid(self, link: int) -> bool:
        """Whether a link is rigid, so that the bodies at its sides move as one."""
        return self._ratios[link] is not None

    def is_forced(self, body: int) -> bool:
        """Whether this body's acceleration is prescribed (`force`)."""
        return body in self._forced

    def slip_rad_s(self, link: int, ratio: float) -> float:
        """Speed before the link times the ratio, less the speed behind it."""
        speed = self._y.speed_rad_s
        return ratio * speed[link] - speed[link + 1]

    def is_driven(self, body: int) -> bool:
        """Whether the acceleration of the body's group is prescribed."""
        return any(k in self._forced for k in self.group(body))

    def force(self, body: int, accel_rad_s2: float) -> None:
        """Prescribes the body's acceleration from now on."""
        self._forced[body] = accel_rad_s2
        self._relink()

    def free(self, body: int) -> None:
        """Ends a prescribed acceleration: torques move the body again."""
        self._forced.pop(body, None)
        self._relink()

    def open(self, link: int) -> None:
        """Opens a link: it carries no torque."""
        self._ratios[link] = None
        self._limit(link, -UNLIMITED, UNLIMITED)
        self._relink()

    def join(
        self, link: int, ratio: float, low_nm: float = -UNLIMITED, high_nm: float = UNLIMITED
    ) -> None:
        """Link rigidly; an impact has brought both sides to one speed. The link's torque leaving
        low..high is an event."""
        self._ratios[link] = ratio
        self._limit(link, low_nm, high_nm)
        self._relink()

    def place(self, link: int, ratio: float) -> None:
        """Links rigidly without an impact, as the bench does: the side of smaller inertia takes the
        other side's speed."""
        self._ratios[link] = ratio
        self._relink()

    def impact(self, link: int, ratio: float, restitution: float) -> float:
        """An impact at a link that is not rigid. Returns the energy lost, J."""
        slip = self.slip_rad_s(link, ratio)
        before, behind = self._feel(link)[0], self._feel(link + 1)[0]
        compliance = ratio**2 * before + behind
        if compliance == 0.0 or slip == 0.0:
            return 0.0
        impulse = (1.0 + restitution) * slip / compliance
        self._kick(link, -ratio * impulse * before)
        self._kick(link + 1, impulse * behind)
        return 0.5 * slip * slip * (1.0 - restitution**2) / compliance

    def group(self, body: int) -> range:
        """The bodies rigidly linked to this one, itself included."""
        first = last = body
        while first > 0 and self._ratios[first - 1] is not None:
            first -= 1
        while last < at.LINKS and self._ratios[last] is not None:
            last += 1
        return range(first, last + 1)

    def kinetic_j(self) -> float:
        """Kinetic energy (J) of all bodies, vehicle included."""
        twice_j = 0.0
        for inertia, speed in zip(self._p.inertia_kgm2, self._y.speed_rad_s, strict=True):
            twice_j += inertia * (speed * speed)
        return 0.5 * twice_j

    def rebuild(self) -> None:
        """Inertias have changed: groups anew."""
        self._known.clear()
        self._relink()

    def _relink(self) -> None:
        """Groups, inertias and accelerations into g; speeds in a group brought in line."""
        forced = self._forced
        key = (*self._ratios, *forced, *forced.values())
        known = self._known.get(key)
        if known is None:
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            known = self._known[key] = self._find_groups()
        else:
            ctypes.memmove(cast(Any, self._g.bodies), known.bodies, len(known.bodies))
        self._felt = known.felt
        self._g.swing_us = known.swing_us
        speed = self._y.speed_rad_s
        for body, rate, lead in known.led:
            speed[body] = rate * speed[lead]
        for link, ratio in enumerate(self._ratios):
            self._g.links[link].carried = ratio or 0.0

    def _find_groups(self) -> _Linked:
        """What `_relink` needs of the present links; into `g.bodies` as well."""
        body, led = 0, []
        while body < at.BODIES:
            members = self.group(body)
            led += self._lead(members)
            body = members.stop
        propeller = self._g.bodies[at.PROPELLER]
        gearbox_kgm2 = self._g.bodies[propeller.lead].group_kgm2 / propeller.rate**2
        swing_us = longest_step_us(self._p.step_us, self._p.twisting, gearbox_kgm2)
        return _Linked(bytes(cast(Any, self._g.bodies)), swing_us, tuple(led), {})

    def rates(self, members: range, lead: int) -> dict[int, float]:
        """Speed of each body of a group over that of its leader."""
        found = {lead: 1.0}
        for k in range(lead, members.stop - 1):
            found[k + 1] = found[k] * (self._ratios[k] or 0.0)
        for k in range(lead, members.start, -1):
            found[k - 1] = found[k] / (self._ratios[k - 1] or 1.0)
        return found

    def _lead(self, members: range) -> list[tuple[int, float, int]]:
        bodies, p, led = self._g.bodies, self._p, []
        forced = [k for k in members if k in self._forced]
        # the vehicle's side leads where both are given: a locked layshaft follows the main shaft
        lead = forced[-1] if forced else members.start
        if not forced and at.MAIN in members:
            lead = at.MAIN
        inertia = 0.0
        for k, rate in self.rates(members, lead).items():
            bodies[k].lead, bodies[k].rate = lead, rate
            inertia += p.inertia_kgm2[k] * rate**2
            if k != lead:
                led.append((k, rate, lead))
        leader = bodies[lead]
        leader.group_kgm2 = inertia
        leader.forced = int(bool(forced))
        leader.accel_rad_s2 = self._forced[lead] if forced else 0.0
        return led

    def _feel(self, body: int) -> tuple[float, dict[int, float]]:
        """1 / inertia of the body's group, felt at the body, and the speeds of the group's bodies
        over its own."""
        found = self._felt.get(body)
        if found is None:
            rates = self.rates(self.group(body), body)
            group_kgm2 = 0.0
            for k, rate in rates.items():
                group_kgm2 += self._p.inertia_kgm2[k] * rate**2
            inverse = 0.0 if self.is_driven(body) else 1.0 / group_kgm2
            found = self._felt[body] = (inverse, rates)
        return found

    def _kick(self, body: int, change_rad_s: float) -> None:
        for k, rate in self._feel(body)[1].items():
            self._y.speed_rad_s[k] += rate * change_rad_s

    def _limit(self, link: int, low_nm: float, high_nm: float) -> None:
        self._g.links[link].low_nm, self._g.links[link].high_nm = low_nm, high_nm
