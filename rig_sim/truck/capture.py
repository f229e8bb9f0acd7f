"""The edges of the truck's sensor wheels in one step, into the capture rings.

Within a step an angle is the cubic through its end angles and speeds; an edge lies where the cubic
meets it. A Hall sensor does not sense direction: a wheel that turns backwards gives edges as well,
and they are counted upwards. Each tooth is then passed from its other side, so the signal rises
where it falls in forward rotation: edges of the falling channel come on the rising one, and vice
versa.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from meshpoint.kernels.jit import inlined, piece
from meshpoint.rig_sim.shared.angle_kernels import TAU
from meshpoint.rig_sim.shared.capture_records import RING, WHEELS
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.layout import Rig
from meshpoint.units import SECOND_US

EDGE_ITERATIONS: Final = 60
SETTLED: Final = 1e-9


class Way(NamedTuple):
    """A wheel's angle over a step: the cubic given by angle and speed at both ends."""

    start_rad: float
    end_rad: float
    start_rad_s: float
    end_rad_s: float
    time_s: float


@inlined
def _share_at(way: Way, angle_rad: float) -> float:
    """When the wheel reaches an angle, as a share 0..1 of the step.

    Newton's method, kept inside a shrinking bracket."""
    start, end, v0, v1, h = way
    length = end - start
    a = (v0 + v1) * h / length - 2.0
    b = 3.0 - (2.0 * v0 + v1) * h / length
    c = v0 * h / length
    wanted = (angle_rad - start) / length
    x, low, high = wanted, 0.0, 1.0
    for _ in range(EDGE_ITERATIONS):
        error = x * (c + x * (b + x * a)) - wanted
        if error > 0.0:
            high = x
        else:
            low = x
        slope = c + x * (2.0 * b + 3.0 * x * a)
        change = error / slope if slope > 0.0 else 2.0
        if not low <= x - change <= high:
            change = x - 0.5 * (low + high)
        x -= change
        if abs(change) < SETTLED:
            break
    return min(max(x, 0.0), 1.0)


@inlined
def _turning_share(way: Way) -> float:
    """When the wheel reverses, as a share 0..1 of the step; its end speeds have opposite signs."""
    start, end, v0, v1, h = way
    length = end - start
    a = 3.0 * ((v0 + v1) * h - 2.0 * length)
    b = 3.0 * length - (2.0 * v0 + v1) * h
    c = v0 * h
    q = -(b + math.copysign(math.sqrt(max(b * b - a * c, 0.0)), b))
    share = c / q if q != 0.0 else 0.5
    if not 0.0 <= share <= 1.0:
        share = q / a
    return min(max(share, 0.0), 1.0)


@inlined
def _write(edge: int, tooth: int, time_us: float, rig: Rig) -> None:
    """Records an edge, unless a fault silences the channel, and any extra edge that a fault
    adds."""
    hall, channel = rig.hall[edge], rig.captured.channels[edge]
    if hall.silent != 0 or hall.missing == tooth + 1:
        return
    for extra in range(1 + hall.extra):
        channel.times_us[channel.count % RING] = time_us + at.EXTRA_EDGE_US * extra
        channel.count += 1


@inlined
def _error_rad(edge: int, speed_rad_s: float, rig: Rig) -> float:
    """Angle (rad) of a channel's next edge less that of the wheel's own edge."""
    count = rig.captured.channels[edge].count
    error = speed_rad_s * rig.jitter_s[(count * 733 + edge * 509) % at.JITTERS]
    if count < at.FIRST_EDGES:
        error += rig.hall[edge].first_rad[count]
    return error


@piece
def _sweep(way: Way, wheel: int, t_us: float, lap: int, rig: Rig) -> None:
    """Records the edges of a wheel that does not reverse, from t_us on; lap: its whole turns."""
    start, end = way.start_rad, way.end_rad
    if end == start:
        return
    forward = end > start
    for row in range(2):
        edge = 2 * wheel + row
        written = edge if forward else edge ^ 1
        hall, pointer = rig.hall[edge], rig.captured.channels[edge]
        while True:
            # a pointer stands at the next edge on the way forward
            tooth, turn = pointer.tooth, pointer.lap
            if not forward:
                tooth -= 1
                if tooth < 0:
                    tooth, turn = hall.teeth - 1, turn - 1
            angle = hall.edges_rad[tooth] + TAU * (turn - lap)
            angle += rig.shaking.load * hall.drift_rad[tooth]
            angle += _error_rad(written, way.start_rad_s, rig)
            if (angle > end) if forward else (angle < end):
                break
            angle = max(angle, start) if forward else min(angle, start)
            time_us = t_us + way.time_s * SECOND_US * _share_at(way, angle)
            _write(written, tooth, time_us, rig)
            if forward:
                tooth += 1
                if tooth == hall.teeth:
                    tooth, turn = 0, turn + 1
            pointer.tooth = tooth
            pointer.lap = turn


@inlined
def _way(wheel: int, h: float, rig: Rig) -> Way:
    """How a sensor wheel turns in a step from y to `after`: with its shaft, the input shaft's with
    its backlash, but for a fault by which it turns at another rate."""
    y, after = rig.y, rig.after
    body = at.BODY_OF_WHEEL[wheel]
    start, end = y.angle_rad[body], after.angle_rad[body]
    v0, v1 = y.speed_rad_s[body], after.speed_rad_s[body]
    if body == at.INPUT:
        start += y.input_lash_rad
        end += after.input_lash_rad
        drift = (after.input_lash_rad - y.input_lash_rad) / h
        v0 += drift
        v1 += drift
    rate, slipped_rad = rig.wheel_rate[wheel], rig.slipped_rad[wheel]
    slips_rad = (rate - 1.0) * (end - start)
    rig.slipped_rad[wheel] = slipped_rad + slips_rad
    return Way(start + slipped_rad, end + slipped_rad + slips_rad, v0 * rate, v1 * rate, h)


@inlined
def capture(t_us: float, h: float, rig: Rig) -> None:
    """All edges of a step from y to `after`, h seconds long, that begins at t_us."""
    for wheel in range(WHEELS):
        way = _way(wheel, h, rig)
        start, end, v0, v1, _ = way
        lap = rig.laps[at.BODY_OF_WHEEL[wheel]]
        if v0 * v1 >= 0.0:
            _sweep(way, wheel, t_us, lap, rig)
            continue
        x = _turning_share(way)
        length = end - start
        a, b = (v0 + v1) * h - 2.0 * length, 3.0 * length - (2.0 * v0 + v1) * h
        turn = start + x * (v0 * h + x * (b + x * a))
        _sweep(Way(start, turn, v0, 0.0, x * h), wheel, t_us, lap, rig)
        back = Way(turn, end, 0.0, v1, (1.0 - x) * h)
        _sweep(back, wheel, t_us + x * h * SECOND_US, lap, rig)
