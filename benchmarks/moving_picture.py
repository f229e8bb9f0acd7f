"""Draws a sleeve that is stopped in flight and fired again, moving: `docs/shift.svg`.

    python -m benchmarks.moving_picture docs/shift.svg

The shift of `benchmarks.abort_picture`, by the rig's truth: the teeth of sleeve and gear unrolled,
and below them the sleeve's way, its valves, and the tooth against the gaps, with the time running
over them. An SVG that moves by itself (SMIL), without a script; where nothing moves, it shows the
contact.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.abort_picture import SEED, Seen, watched_shift
from meshpoint.kernels.records import Vector
from meshpoint.report.layout import BLUE, GREEN, GREY, INK, ORANGE
from meshpoint.units import DEG, MM

WIDTH, HEIGHT = 880, 560
LEFT, RIGHT = 150, 864
SLOWER: Final = 60.0
"""The shift runs at this part of its speed."""
HOLD_S: Final = 2.0
"""The end stands for so long before it begins again."""
STEP_MS: Final = 1.0
PITCHES: Final = 3.0
"""Seen side by side."""
TEETH = (40.0, 250.0)
"""The part of the picture in which the teeth are: top and bottom."""
SLEEVE_MM_PX: Final = 8.5
TOOTH_PX: Final = 62.0
TRACKS = {"sleeve": (292.0, 362.0), "valves": (376.0, 408.0), "phase": (422.0, 516.0)}
FONT: Final = "system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif"


class Moving:
    """What is drawn, sampled every `STEP_MS`, and how time runs."""

    def __init__(self, seen: Seen) -> None:
        self.seen = seen
        self.ms: Vector = np.arange(seen.ms[0], seen.ms[-1], STEP_MS)
        self.pitch = seen.sheet.dog.pitch_rad / DEG
        self.gap = seen.sheet.dog.backlash_rad / DEG
        self.travel_mm = np.interp(self.ms, seen.ms, seen.samples["position_m"] / MM)
        phase = np.unwrap(seen.samples["phase_rad"] / DEG, period=self.pitch)
        phase -= self.pitch * np.round(np.interp(seen.contact_ms, seen.ms, phase) / self.pitch)
        self.phase_deg = np.interp(self.ms, seen.ms, phase)
        self.lasts_s = float(self.ms[-1] - self.ms[0]) / 1e3 * SLOWER + HOLD_S

    def share(self, at_ms: float) -> float:
        """Where a moment is in the picture's own time, 0 to 1."""
        return float(at_ms - self.ms[0]) / 1e3 * SLOWER / self.lasts_s

    def x(self, at_ms: float) -> float:
        """Where a moment is on the time axis."""
        return LEFT + (RIGHT - LEFT) * float((at_ms - self.ms[0]) / (self.ms[-1] - self.ms[0]))

    def timing(self, moments_ms: Sequence[float]) -> str:
        """The attributes of an animation with values at these moments, and at the end."""
        shares = ";".join(f"{self.share(at):.4f}" for at in moments_ms)
        return f'keyTimes="{shares};1" dur="{self.lasts_s:.1f}s" repeatCount="indefinite"'

    def moves(self, xs: Vector, ys: Vector) -> str:
        """A group's translation as time runs."""
        values = [f"{x:.1f} {y:.1f}" for x, y in zip(xs, ys, strict=True)]
        return (
            '<animateTransform attributeName="transform" type="translate" '
            f'values="{";".join([*values, values[-1]])}" {self.timing(self.ms.tolist())}/>'
        )

    def during(self, name: str, off: str, on: str, from_ms: float, to_ms: float) -> str:
        """An attribute that is `on` from one moment to another; to the end where `to_ms` is that of
        the last sample."""
        to_the_end = to_ms >= float(self.ms[-1])
        moments = [float(self.ms[0]), from_ms, *([] if to_the_end else [to_ms])]
        values = [off, on, *([] if to_the_end else [off])]
        if from_ms <= moments[0]:
            moments, values = moments[1:], values[1:]
        return (
            f'<animate attributeName="{name}" calcMode="discrete" '
            f'values="{";".join([*values, values[-1]])}" {self.timing(moments)}/>'
        )


def picture(seen: Seen) -> str:
    """The whole SVG."""
    moving, row = Moving(seen), seen.row
    title = (
        f"A sleeve that would meet a tooth is stopped short of it and fired again: gear "
        f"{row.from_} to {row.to}"
    )
    of = (
        f"simulated, 1/{SLOWER:.0f} of its speed; sheet {seen.sheet.name}, profile typical, seed "
        f"{SEED}, gear {row.from_} to {row.to}"
    )
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="{FONT}" font-size="14" role="img">',
        f"<title>{title}</title>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
        _teeth(moving),
        _captions(moving),
        _tracks(moving),
        _text(RIGHT, HEIGHT - 10, of, 12, text_anchor="end", fill=GREY),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _rect(x: float, y: float, wide: float, high: float, fill: str = "") -> str:
    color = f' fill="{fill}"' if fill else ""
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{wide:.1f}" height="{high:.1f}"{color}/>'


def _text(x: float, y: float, words: str, size: int, **style: str) -> str:
    more = "".join(f' {name.replace("_", "-")}="{value}"' for name, value in style.items())
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}"{more}>{words}</text>'


def _teeth(moving: Moving) -> str:
    """Sleeve above, gear below, unrolled; the gear's turn past the sleeve, the sleeve moves in.
    Both have teeth of one width."""
    top, bottom = TEETH
    deg_px = (WIDTH - 20) / (PITCHES * moving.pitch)
    middle, contact_mm = WIDTH / 2, moving.seen.sheet.sleeve.to_contact_m / MM
    front = top + 26.0 + TOOTH_PX
    gear_front = front + contact_mm * SLEEVE_MM_PX
    half, pitch = (moving.pitch - moving.gap) / 4.0 * deg_px, moving.pitch * deg_px
    sleeve = [_tooth(middle + (k + 0.5) * pitch, front, -1, half) for k in range(-3, 3)]
    gear = [_tooth(middle + k * pitch, gear_front, 1, half) for k in range(-3, 4) if k]
    zeros = np.zeros(moving.ms.size)
    met_deg = float(np.interp(moving.seen.contact_ms, moving.ms, moving.phase_deg))
    ends = moving.seen.contact_ms, float(moving.ms[-1])
    color = moving.during("fill", "#e6a26b", "#5fb39a", *ends)
    return "\n".join(
        (
            f'<clipPath id="teeth">{_rect(10, top, WIDTH - 20, bottom - top)}</clipPath>',
            f'<g clip-path="url(#teeth)">{_rect(10, top, WIDTH - 20, bottom - top, "#fafafa")}',
            f'<path d="M{middle} {top}V{bottom}" stroke="{GREEN}" stroke-dasharray="4 4"/>',
            f'<g fill="#c8c8c8" stroke="#555" transform="translate({met_deg * deg_px:.1f} 0)">',
            moving.moves(moving.phase_deg * deg_px, zeros),
            f'<path d="{" ".join(gear)}"/>',
            f'<path d="{_tooth(middle, gear_front, 1, half)}" fill="#5fb39a">{color}</path>',
            f"{_rect(-WIDTH, gear_front + TOOTH_PX, 3 * WIDTH, 90)}</g>",
            '<g fill="#8fbcdb" stroke="#005b8f" '
            f'transform="translate(0 {contact_mm * SLEEVE_MM_PX:.1f})">',
            moving.moves(zeros, moving.travel_mm * SLEEVE_MM_PX),
            f'<path d="{" ".join(sleeve)}"/>',
            f"{_rect(-WIDTH, front - TOOTH_PX - 190, 3 * WIDTH, 190)}</g></g>",
            _text(20, top + 19, "sleeve", 14, fill="#005b8f", font_weight="600"),
            _text(20, bottom - 7, "gear", 14, fill="#333", font_weight="600"),
        )
    )


def _tooth(x: float, front: float, side: int, half: float) -> str:
    """A path; side: +1 where the tooth's body lies below its front."""
    root, edge = front + side * TOOTH_PX, 4.0
    return (
        f"M{x - half:.1f} {root:.1f}V{front + side * edge:.1f}L{x - half + edge:.1f} {front:.1f}"
        f"H{x + half - edge:.1f}L{x + half:.1f} {front + side * edge:.1f}V{root:.1f}Z"
    )


def _captions(moving: Moving) -> str:
    """What happens, one line at a time; the last one stands where nothing moves."""
    seen = moving.seen
    moments = [
        float(moving.ms[0]), seen.fired_ms, seen.aborted_ms, seen.held_ms, seen.again_ms,
        seen.contact_ms, float(moving.ms[-1]),
    ]  # fmt: skip
    lines = (
        ("the brake brings the gear to the sleeve's speed", INK),
        ("fired: tooth is predicted to meet gap when the sleeve arrives", BLUE),
        ("newer edges say that it would meet a tooth: stopped by the opposite valve", ORANGE),
        ("held by friction short of the teeth, until the gap comes", INK),
        ("fired again", BLUE),
        ("tooth meets gap: in gear", GREEN),
    )
    made = []
    for k, ((words, color), span) in enumerate(zip(lines, pairwise(moments), strict=True)):
        shown = "1" if k == len(lines) - 1 else "0"
        animated = words + moving.during("opacity", "0", "1", *span)
        style = {"text_anchor": "middle", "font_weight": "600", "fill": color, "opacity": shown}
        made.append(_text(WIDTH / 2, 26, animated, 17, **style))
    return "\n".join(made)


def _tracks(moving: Moving) -> str:
    """The sleeve's way, its valves and the phase over time, and the line of now."""
    seen = moving.seen
    first, last = TRACKS["sleeve"][0], TRACKS["phase"][1]
    moments = {
        "fired": seen.fired_ms, "stopped": seen.aborted_ms, "fired again": seen.again_ms,
        "gap met": seen.contact_ms,
    }  # fmt: skip
    lines = [
        f'<path d="M{moving.x(at):.1f} {first}V{last}" stroke="{GREY}" stroke-dasharray="3 3"/>'
        + _text(moving.x(at), first - 10, name, 13, text_anchor="middle")
        for name, at in moments.items()
    ]
    scale = [
        _text(moving.x(at), last + 17, f"{at} ms", 12, text_anchor="middle", fill=GREY)
        for at in range(0, int(moving.ms[-1]), 20)
    ]
    now = np.array([moving.x(at) for at in moving.ms])
    cursor = (
        f'<path d="M0 {first - 4}V{last}" stroke="#c00" stroke-width="1.5" '
        f'transform="translate({moving.x(seen.contact_ms):.1f} 0)">'
        f"{moving.moves(now, np.zeros(now.size))}</path>"
    )
    return "\n".join([_way(moving), _valves(moving), _phase(moving), *lines, *scale, cursor])


def _line(moving: Moving, ys: Vector) -> str:
    points = " ".join(f"{moving.x(at):.1f},{y:.1f}" for at, y in zip(moving.ms, ys, strict=True))
    return f'<polyline fill="none" stroke="{INK}" stroke-width="2" points="{points}"/>'


def _name(track: str, *words: str) -> str:
    """In lines, left of the track."""
    middle = sum(TRACKS[track]) / 2 + 5 - 8 * (len(words) - 1)
    return "".join(
        _text(LEFT - 12, middle + 16 * k, word, 13, text_anchor="end")
        for k, word in enumerate(words)
    )


def _way(moving: Moving) -> str:
    top, bottom = TRACKS["sleeve"]
    sleeve, high = moving.seen.sheet.sleeve, bottom - top
    stroke_mm, contact_mm = sleeve.stroke_m / MM, sleeve.to_contact_m / MM
    teeth = bottom - high * contact_mm / stroke_mm
    return (
        _rect(LEFT, top, RIGHT - LEFT, teeth - top, "#e9e9e9")
        + _text(LEFT + 8, teeth - 5, "at the gear's teeth", 12, fill=GREY)
        + _line(moving, bottom - high * moving.travel_mm / stroke_mm)
        + _name("sleeve", "way of the", "sleeve")
    )


def _valves(moving: Moving) -> str:
    top, bottom = TRACKS["valves"]
    high = (bottom - top) / 2 - 2
    bars = []
    for lane, (name, color) in enumerate((("towards_coil", BLUE), ("against_coil", ORANGE))):
        on = np.interp(moving.ms, moving.seen.ms, moving.seen.samples[name]) > 0.5
        edges = np.flatnonzero(np.diff(np.concatenate(([0], on.astype(int), [0]))))
        for span in edges.reshape(-1, 2).tolist():
            start, end = (moving.x(moving.ms[min(k, moving.ms.size - 1)]) for k in span)
            bars.append(_rect(start, top + lane * (high + 4), end - start, high, color))
    return "".join(bars) + _name("valves", "valve on,", "opposite valve")


def _phase(moving: Moving) -> str:
    top, bottom = TRACKS["phase"]
    seen, half = moving.seen, moving.gap / 2
    low = min(float(moving.phase_deg.min()), -half) - 0.5
    high = max(float(moving.phase_deg.max()), half) + 0.5

    def y(deg: float) -> float:
        return bottom - (bottom - top) * (min(max(deg, low), high) - low) / (high - low)

    gaps = [moving.pitch * k for k in range(-3, 4)]
    bands = [
        _rect(LEFT, y(gap + half), RIGHT - LEFT, y(gap - half) - y(gap + half), "#d5efe4")
        for gap in gaps
        if gap + half > low and gap - half < high
    ]
    missed, met = (
        (moving.x(at), y(float(np.interp(at, moving.ms, moving.phase_deg))))
        for at in (seen.missed_ms, seen.contact_ms)
    )
    cross = f"M{missed[0] - 6:.1f} {missed[1] - 6:.1f}l12 12m0 -12l-12 12"
    marks = (
        f'<path d="{cross}" stroke="{ORANGE}" stroke-width="3.5"/>',
        _text(missed[0] + 12, missed[1] + 16, "where it would have met", 12, fill="#a83f00"),
        f'<circle cx="{met[0]:.1f}" cy="{met[1]:.1f}" r="6" fill="{GREEN}" stroke="{INK}"/>',
    )
    line = _line(moving, np.array([y(deg) for deg in moving.phase_deg]))
    return "".join([*bands, line, *marks, _name("phase", "tooth against", "the gaps")])


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(picture(watched_shift()), encoding="utf-8", newline="\n")
