"""The five bodies and their links: groups of rigidly linked bodies, and impacts between them.

An impact at a link with ratio i (speed behind over speed before), slip s = i w_before - w_behind:

    J_eq = 1 / (i^2 / J_before + 1 / J_behind)
    impulse J_eq (1 + e) s,  loss J_eq s^2 (1 - e^2) / 2

on the groups' inertias felt at the link. A body whose speed the bench gives has infinite inertia.
"""

from __future__ import annotations

from typing import Final

from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.driveline import longest_step_us
from meshpoint.rig_sim.truck.layout import Rig

UNLIMITED: Final = float("inf")


class BodyChain:
    """Which of the five bodies are linked. Works in place on the rig's state and connections."""

    def __init__(self, rig: Rig) -> None:
        self._p, self._y, self._g = rig.p, rig.y, rig.g
        self._ratios: list[float | None] = [None] * at.LINKS
        self._forced: dict[int, float] = {}
        for link in range(at.LINKS):
            self._limit(link, -UNLIMITED, UNLIMITED)
        self.rebuild()

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
        self.rebuild()

    def free(self, body: int) -> None:
        """Ends a prescribed acceleration: torques move the body again."""
        self._forced.pop(body, None)
        self.rebuild()

    def open(self, link: int) -> None:
        """Opens a link: it carries no torque."""
        self._ratios[link] = None
        self._limit(link, -UNLIMITED, UNLIMITED)
        self.rebuild()

    def join(
        self, link: int, ratio: float, low_nm: float = -UNLIMITED, high_nm: float = UNLIMITED
    ) -> None:
        """Link rigidly; an impact has brought both sides to one speed. The link's torque leaving
        low..high is an event."""
        self._ratios[link] = ratio
        self._limit(link, low_nm, high_nm)
        self.rebuild()

    def place(self, link: int, ratio: float) -> None:
        """Links rigidly without an impact, as the bench does: the side of smaller inertia takes the
        other side's speed."""
        self._ratios[link] = ratio
        self.rebuild()

    def impact(self, link: int, ratio: float, restitution: float) -> float:
        """An impact at a link that is not rigid. Returns the energy lost, J."""
        slip = self.slip_rad_s(link, ratio)
        before, behind = self._inverse_inertia(link), self._inverse_inertia(link + 1)
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
        """Groups, inertias and accelerations into g; speeds in a group brought in line."""
        body = 0
        while body < at.BODIES:
            members = self.group(body)
            self._lead(members)
            body = members.stop
        for link, ratio in enumerate(self._ratios):
            self._g.links[link].carried = ratio or 0.0
        propeller = self._g.bodies[at.PROPELLER]
        gearbox_kgm2 = self._g.bodies[propeller.lead].group_kgm2 / propeller.rate**2
        self._g.swing_us = longest_step_us(self._p.step_us, self._p.twisting, gearbox_kgm2)

    def rates(self, members: range, lead: int) -> dict[int, float]:
        """Speed of each body of a group over that of its leader."""
        found = {lead: 1.0}
        for k in range(lead, members.stop - 1):
            found[k + 1] = found[k] * (self._ratios[k] or 0.0)
        for k in range(lead, members.start, -1):
            found[k - 1] = found[k] / (self._ratios[k - 1] or 1.0)
        return found

    def _lead(self, members: range) -> None:
        bodies, p, speed = self._g.bodies, self._p, self._y.speed_rad_s
        forced = [k for k in members if k in self._forced]
        # the vehicle's side leads where both are given: a locked layshaft follows the main shaft
        lead = forced[-1] if forced else members.start
        if not forced and at.MAIN in members:
            lead = at.MAIN
        inertia = 0.0
        for k, rate in self.rates(members, lead).items():
            bodies[k].lead, bodies[k].rate = lead, rate
            inertia += p.inertia_kgm2[k] * rate**2
            speed[k] = rate * speed[lead]
        leader = bodies[lead]
        leader.group_kgm2 = inertia
        leader.forced = int(bool(forced))
        leader.accel_rad_s2 = self._forced[lead] if forced else 0.0

    def _inverse_inertia(self, body: int) -> float:
        members = self.group(body)
        if self.is_driven(body):
            return 0.0
        group_kgm2 = 0.0
        for k, rate in self.rates(members, body).items():
            group_kgm2 += self._p.inertia_kgm2[k] * rate**2
        return 1.0 / group_kgm2

    def _kick(self, body: int, change_rad_s: float) -> None:
        for k, rate in self.rates(self.group(body), body).items():
            self._y.speed_rad_s[k] += rate * change_rad_s

    def _limit(self, link: int, low_nm: float, high_nm: float) -> None:
        self._g.links[link].low_nm, self._g.links[link].high_nm = low_nm, high_nm
