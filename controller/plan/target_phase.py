"""Aiming: fire so that the teeth have the wanted phase when the sleeve arrives (thesis 6.2).

Release and contact are those of least expected cost under the uncertainty of the predicted phase:
time, the price of a miss, and the energy that the flanks take (docs/strategy.md).

At a contact at time t the phase is spread about its prediction phi with variance v(t) + (slip
sigma_delay)^2. The tooth passes the overlap without meeting a flank if its phase at contact lies in
[-b/2, b/2 - slip t_overlap] (slip > 0; mirrored for slip < 0): P is the probability of that
interval under the normal law. The cost, in seconds:

    (t - now) + (1 - P) (miss + block min(1, s_block / |slip|))
        + energy slip^2 + aim ((phi - phi*) / (b/2))^2

phi* is the target angle less half of what the slip moves the tooth through the overlap. The cost is
compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.controller.plan.gear_predictor import GearPredictor, Trajectory
from meshpoint.controller.plan.strategy import (
    ReleasePlan,
    known_until_stop_us,
    last_measurement,
    release_for_slip,
    settle_time_us,
)
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.kernels.jit import compiled, inlined, record_on
from meshpoint.kernels.records import WORD_BYTES, Vector, filled, layout_of
from meshpoint.units import SECOND_US

LEAST_VARIANCE: Final = 1e-10
OUTSIDE_S: Final = 0.05
OUTSIDE: Final = 0.1
"""Added cost of a contact outside the allowed slips, in s, and in s for each rad/s: it is chosen
only if the gaps within reach are all outside, and then the nearest."""

RELEASE_AHEAD_US: Final = 300_000.0
"""How far ahead contacts of a release are searched: in that time the slip falls out of its
window."""
FIRING_AHEAD_US: Final = 600_000.0
"""How far ahead contacts of a firing are searched: where little drag is left, and the teeth pass
slowly, a gap may come late."""
COARSE_US: Final = 2_000.0
"""Longest step from contact to contact in a coarse search."""
LEAST_COARSE_US: Final = 200.0
"""Shortest such step."""
STEP_OF_PITCH: Final = 0.04
"""In a coarse step the phase moves by no more than this share of a pitch."""
STEP_OF_WINDOW: Final = 0.07
"""In a coarse step the slip moves by no more than this share of the slips allowed."""
FINE_SHARE: Final = 20
"""A coarse step has this many fine ones, which are looked at around the best of the coarse ones."""
FALL_US: Final = 20_000
"""The rate at which slip falls without the brake is taken over this time."""
NEAR_US: Final = 50_000
"""A release further ahead is not aimed yet, since it is planned again at every tick."""
EARLIER_SHARE: Final = 0.5
"""Releases are tried from so much before the unaimed one on, in shares of the time by which a
release moves the phase at contact by a pitch."""
LATER_SHARE: Final = 0.7
"""Releases are tried until so much after the unaimed one: with `EARLIER_SHARE` more than a
pitch."""
RELEASES: Final = 14
"""Number of releases that are tried: the firing makes up for what lies between two of them."""
MOST_REACH_US: Final = 40_000.0
LEAST_REACH_US: Final = 500.0
"""The span of the releases looked at is kept within these."""
PROBE_US: Final = 500
"""How far a release moves the phase is found by moving it so much."""
CLEAR_US: Final = 10_000
"""The earliest firing is so much less before the release than the sleeve takes to its gear: it
meets the gear when the brake has been released."""
SLOWEST_M_S: Final = 0.05
"""A sleeve that meets a gear at all does so no slower."""


class ContactSeries:
    """Contacts at equal steps of time."""

    wait_s: float
    """From now to the first."""
    step_s: float


class Terms:
    """The parameters of the cost (docs/strategy.md)."""

    pitch_rad: float
    half_gap_rad: float
    target_rad: float
    overlap_s: float
    """Time through the overlap."""
    delay_sd_s: float
    miss_s: float
    block_s: float
    """Price of a miss, and what may be added to it where the tooth may block."""
    block_slip_rad_s: float
    """Below this slip the tooth may block."""
    energy_s3_rad2: float
    """Price of (rad/s)^2 of slip, in seconds."""
    aim_s: float
    """Price of being half a gap off the target."""
    slip_low_rad_s: float
    slip_high_rad_s: float
    """Allowed slips."""


CONTACT_SERIES: Final = layout_of(ContactSeries)
TERMS: Final = layout_of(Terms)


@inlined
def contact_cost(
    wait_s: float, phase: float, slip: float, variance: float, terms: Terms, enough: float
) -> float:
    """The cost in seconds; phase unwrapped (rad), slip (rad/s), variance of the phase without what
    the delay adds (rad2). Where even a sure hit would cost `enough` or more, the cost of that: the
    probability of a hit is most of the work, and does not matter then."""
    half, pitch = terms.half_gap_rad, terms.pitch_rad
    moved = slip * terms.overlap_s
    centre = terms.target_rad - 0.5 * moved
    off = phase - centre
    off -= pitch * math.floor(off / pitch + 0.5)
    energy, aim, outside = terms.energy_s3_rad2 * slip * slip, terms.aim_s * (off / half) ** 2, 0.0
    if slip > terms.slip_high_rad_s:
        outside = OUTSIDE_S + OUTSIDE * (slip - terms.slip_high_rad_s)
    elif slip < terms.slip_low_rad_s:
        outside = OUTSIDE_S + OUTSIDE * (terms.slip_low_rad_s - slip)
    # In the order of the sum below: rounding, too, keeps it the lower one.
    least = wait_s + energy + aim + outside
    if least >= enough:
        return float(least)
    at = centre + off
    low, high = -half - min(moved, 0.0), half - max(moved, 0.0)
    delay = slip * terms.delay_sd_s
    root = math.sqrt(2.0 * (variance + delay * delay + LEAST_VARIANCE))
    hit = 0.0
    if high > low:
        hit = 0.5 * (math.erf((high - at) / root) - math.erf((low - at) / root))
    size = abs(slip)
    miss = terms.miss_s + terms.block_s * min(1.0, terms.block_slip_rad_s / max(size, 1e-6))
    return float(wait_s + (1.0 - hit) * miss + energy + aim + outside)


@compiled
def cheapest(
    phase: Vector, slip: Vector, variance: Vector, contacts: Vector, terms: Vector
) -> tuple[int, float]:
    """Index and cost of the cheapest contact of a trajectory: phase and slip at each contact, and
    the phase's variance without what the delay adds.

    contacts: a `ContactSeries`; terms: `Terms`."""
    series, price = record_on(contacts, CONTACT_SERIES), record_on(terms, TERMS)
    best, least = 0, math.inf
    for k in range(phase.shape[0]):
        later = k * series.step_s
        cost = contact_cost(series.wait_s + later, phase[k], slip[k], variance[k], price, least)
        if cost < least:
            best, least = k, cost
    return best, least


@compiled
def best_trajectory(
    found: Vector,
    variance: Vector,
    waits_s: Vector,
    contacts: Vector,
    terms: Vector,
    comes_sd_rad: float,
) -> tuple[int, int]:
    """Of several trajectories, found (m, 2, n), the one whose cheapest contact is expected to cost
    least, and the index of that contact.

    waits_s (m,): from now to the first contact of each, `ContactSeries.wait_s`, which is set.
    comes_sd_rad: by so much the predicted phase will still move (standard deviation), the contact
    with it: the mean over three phases, by Gauss and Hermite (Abramowitz and Stegun, 25.4.46)."""
    series = record_on(contacts, CONTACT_SERIES)
    chosen, best, least, off = 0, 0, math.inf, math.sqrt(3.0) * comes_sd_rad
    for r in range(found.shape[0]):
        series.wait_s = waits_s[r]
        index, cost = cheapest(found[r, 0], found[r, 1], variance, contacts, terms)
        if off > 0.0:
            _, low = cheapest(found[r, 0] - off, found[r, 1], variance, contacts, terms)
            _, high = cheapest(found[r, 0] + off, found[r, 1], variance, contacts, terms)
            cost = (4.0 * cost + low + high) / 6.0
        if cost < least:
            chosen, best, least = r, index, cost
    return chosen, best


def warm_up() -> None:
    """Compiles the kernels, or loads what was compiled before."""
    found = np.ones((1, 2, 1))
    contacts = filled(CONTACT_SERIES, wait_s=0.0, step_s=1.0)
    one, terms = np.ones(1), np.ones(TERMS.itemsize // WORD_BYTES)
    cheapest(one, one, one, contacts, terms)
    best_trajectory(found, one, one, contacts, terms, 1.0)


class TargetPhase:
    """Fires so that tooth meets gap."""

    aims: Final = True

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        window = settings.window
        self.fire_slip_rad_s = window.contact_high_rad_s
        self._dog = sheet.dog
        self._window, self._prices = window, settings.prices
        self._brake_nm_per_pa = sheet.brake_nm_per_pa
        self._target_rad = settings.aim.target_rad(sheet.dog.backlash_rad)
        self._settle_us = settle_time_us(sheet, window.aim_time_constants)
        self._timing = settings.timing

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:
        """The contact of least expected cost that a sleeve not yet fired can still make; None where
        the gear is too fast in all of them: drag brings those that are not."""
        first_us = float(earliest_us + predictor.delay_us)
        step_us, count = self._steps(predictor, earliest_us, FIRING_AHEAD_US)
        coarse = predictor.trajectory(first_us, step_us, count)
        around_us = max(first_us, self._cheapest(predictor, now_us, coarse) - step_us)
        fine = predictor.trajectory(around_us, step_us / FINE_SHARE, 2 * FINE_SHARE + 1)
        contact_us = self._cheapest(predictor, now_us, fine)
        is_too_fast = predictor.slip_rad_s(contact_us) > self._window.contact_high_rad_s
        return None if is_too_fast else round(contact_us)

    def is_to_go_back(
        self, predictor: GearPredictor, now_us: int, contact_us: int, earliest_us: int
    ) -> bool:
        """Whether a sleeve that is fired anew, at `earliest_us` or later, is expected to cost less
        than one that is on its way to its contact."""
        on_way = predictor.trajectory(float(contact_us), 1.0, 1)
        variances = predictor.variances(float(contact_us), 1.0, 1) + predictor.reference_variance
        stays = self._least(predictor, now_us, on_way, variances)[1]
        step_us, count = self._steps(predictor, earliest_us, FIRING_AHEAD_US)
        later = predictor.trajectory(float(earliest_us + predictor.delay_us), step_us, count)
        # By then as much will be known of a later contact as now of this one.
        return self._least(predictor, now_us, later, np.full(count, variances[0]))[1] < stays

    def _steps(
        self, predictor: GearPredictor, release_us: int, ahead_us: float = RELEASE_AHEAD_US
    ) -> tuple[float, int]:
        """Length and number of the coarse steps of contacts: small where teeth are small, or where
        drag soon takes the slip away."""
        window = self._window
        after_us = release_us + self._settle_us
        fall = predictor.steady_slip_rad_s(after_us, release_us) - predictor.steady_slip_rad_s(
            after_us + FALL_US, release_us
        )
        allowed = window.contact_high_rad_s - window.contact_low_rad_s
        by_slip_us = STEP_OF_WINDOW * allowed * FALL_US / max(fall, 1e-6)
        by_phase_us = STEP_OF_PITCH * self._dog.pitch_rad / window.contact_high_rad_s * SECOND_US
        step_us = max(LEAST_COARSE_US, min(COARSE_US, by_slip_us, by_phase_us))
        return step_us, math.ceil(ahead_us / step_us)

    def _reach_us(self, predictor: GearPredictor, release_us: int) -> float:
        """By how much later a release moves the phase at contact by a pitch."""
        contact_us = float(release_us + round(self._settle_us) + FALL_US)
        sooner = predictor.trajectory(contact_us, COARSE_US, 1, release_us)
        later = predictor.trajectory(contact_us, COARSE_US, 1, release_us + PROBE_US)
        moved = abs(float(later.phase_rad[0] - sooner.phase_rad[0]))
        reach_us = PROBE_US * self._dog.pitch_rad / max(moved, 1e-9)
        return min(max(reach_us, LEAST_REACH_US), MOST_REACH_US)

    def release(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> ReleasePlan:
        """Release and contact planned together: of the releases around the one that leaves
        `window.aim_slip_rpm`, the one whose best contact costs least."""
        slip, settle_us = self._window.aim_slip_rad_s, self._settle_us
        release_us = release_for_slip(predictor, earliest_us, slip, settle_us)
        if release_us > earliest_us + NEAR_US:
            return ReleasePlan(release_us, release_us + round(settle_us))
        releases_us = self._releases(predictor, earliest_us, release_us)
        step_us, count = self._steps(predictor, releases_us[0])
        delay_us = predictor.delay_us
        fires_us = [max(each - delay_us + CLEAR_US, earliest_us) for each in releases_us]
        firsts_us = [float(fire_us + delay_us) for fire_us in fires_us]
        found = predictor.trajectories(releases_us, firsts_us, step_us, count)
        first = Trajectory(firsts_us[0], step_us, *found[0])
        settled = self._settled_variances(predictor, first, now_us, releases_us[0])
        waits_s = (np.array(firsts_us) - now_us) / SECOND_US
        comes_sd_rad = _comes_sd_rad(predictor, first, settled, release_us + settle_us)
        chosen, index = best_trajectory(
            found, settled, waits_s, _contacts(first, now_us), self._terms(predictor), comes_sd_rad
        )
        return ReleasePlan(releases_us[chosen], round(firsts_us[chosen] + index * step_us))

    def _releases(self, predictor: GearPredictor, earliest_us: int, release_us: int) -> range:
        """The releases around one that together move the phase by more than a pitch."""
        reach_us = self._reach_us(predictor, release_us)
        first_us = max(earliest_us, release_us - round(EARLIER_SHARE * reach_us))
        last_us = release_us + round(LATER_SHARE * reach_us)
        step_us = max(1, round((EARLIER_SHARE + LATER_SHARE) * reach_us / RELEASES))
        return range(first_us, last_us + 1, step_us)

    def _cheapest(self, predictor: GearPredictor, now_us: int, trajectory: Trajectory) -> float:
        """Time of a trajectory's cheapest contact."""
        measurement = last_measurement(predictor, self._timing)
        first_us, step_us, phase, _ = trajectory
        settled = predictor.known_variances(first_us, step_us, phase.size, now_us, measurement)
        variances = settled + predictor.reference_variance
        best, _ = self._least(predictor, now_us, trajectory, variances)
        return trajectory.first_us + best * trajectory.step_us

    def _least(
        self, predictor: GearPredictor, now_us: int, trajectory: Trajectory, variances: Vector
    ) -> tuple[int, float]:
        """A trajectory's cheapest contact, and its cost (s)."""
        phase, slip = trajectory.phase_rad, trajectory.slip_rad_s
        contacts, terms = _contacts(trajectory, now_us), self._terms(predictor)
        return cheapest(phase, slip, variances, contacts, terms)

    def _settled_variances(
        self, predictor: GearPredictor, trajectory: Trajectory, now_us: int, release_us: int
    ) -> Vector:
        """Variances of the phase that are left when the sleeve for each contact can last be
        stopped."""
        first_us, step_us, phase, _ = trajectory
        firing_us = float(now_us + predictor.delay_us)
        known_us = known_until_stop_us(predictor, self._timing)
        before = round((max(0.0, first_us - firing_us) + known_us) / step_us)
        settled = predictor.variances(firing_us, step_us, before + phase.size, release_us)[before:]
        return np.asarray(settled + predictor.reference_variance)

    def _terms(self, predictor: GearPredictor) -> Vector:
        """The terms of `contact_cost` for this gear."""
        window, prices, dog = self._window, self._prices, self._dog
        inertia = self._brake_nm_per_pa / predictor.model.brake_rad_s2_pa
        return filled(
            TERMS,
            pitch_rad=dog.pitch_rad,
            half_gap_rad=dog.backlash_rad / 2.0,
            target_rad=self._target_rad,
            overlap_s=dog.most_overlap_m / max(predictor.contact_speed_m_s, SLOWEST_M_S),
            delay_sd_s=predictor.delay_sd_s,
            miss_s=prices.miss_s,
            block_s=prices.block_s,
            block_slip_rad_s=prices.block_slip_rad_s,
            energy_s3_rad2=prices.energy_s_per_j * 0.5 * inertia / predictor.i_gear**2,
            aim_s=prices.aim_s,
            slip_low_rad_s=window.contact_low_rad_s,
            slip_high_rad_s=window.contact_high_rad_s,
        )


def _comes_sd_rad(
    predictor: GearPredictor, trajectory: Trajectory, settled: Vector, contact_us: float
) -> float:
    """By how much (standard deviation) the phase that is predicted now for a contact will have
    moved when its sleeve can last be stopped. What is settled then is left out."""
    index = round((contact_us - trajectory.first_us) / trajectory.step_us)
    left = settled[min(max(index, 0), settled.size - 1)] - predictor.reference_variance
    return math.sqrt(max(0.0, predictor.estimate_variance(contact_us) - left))


def _contacts(trajectory: Trajectory, now_us: int) -> Vector:
    """The contacts of a trajectory for `cheapest`."""
    return filled(
        CONTACT_SERIES,
        wait_s=(trajectory.first_us - now_us) / SECOND_US,
        step_s=trajectory.step_us / SECOND_US,
    )
