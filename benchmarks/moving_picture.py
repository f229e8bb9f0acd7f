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
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.abort_picture import SEED, Seen, watched_shift
from meshpoint.kernels.records import Vector
from meshpoint.testbench.report.layout import BLUE, GREEN, GREY, INK, ORANGE
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
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="{FONT}" font-size="14" role="img">',
        f"<title>{title}</title>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
        _teeth(moving),
        _captions(moving),
        _tracks(moving),
        f'<text x="{RIGHT}" y="{HEIGHT - 10}" text-anchor="end" font-size="12" fill="{GREY}">'
        f"simulated, 1/{SLOWER:.0f} of its speed; sheet {seen.sheet.name}, profile typical, seed "
        f"{SEED}, gear {row.from_} to {row.to}</text>",
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _teeth(moving: Moving) -> str:
    """Sleeve above, gear below, unrolled; the gear's turn past the sleeve, the sleeve moves in."""
    top, bottom = TEETH
    deg_px = (WIDTH - 20) / (PITCHES * moving.pitch)
    middle, contact_mm = WIDTH / 2, moving.seen.sheet.sleeve.to_contact_m / MM
    front = top + 26.0 + TOOTH_PX
    gear_front = front + contact_mm * SLEEVE_MM_PX
    half = (moving.pitch - moving.gap) / 4.0 * deg_px
    """Sleeve and gear have teeth of one width."""
    sleeve = [_comb(middle + (k + 0.5) * moving.pitch * deg_px, front, -1, half) for k in range(-3, 3)]
    gear = [
        _comb(middle + k * moving.pitch * deg_px, gear_front, 1, half) for k in range(-3, 4) if k
    ]
    aimed = _comb(middle, gear_front, 1, half)
    at_contact = int(np.argmin(np.abs(moving.ms - moving.seen.contact_ms)))
    zeros = np.zeros(moving.ms.size)
    end_ms = float(moving.ms[-1])
    color = moving.during("fill", "#e6a26b", "#5fb39a", moving.seen.contact_ms, end_ms)
    return "\n".join(
        (
            f'<clipPath id="teeth"><rect x="10" y="{top}" width="{WIDTH - 20}" '
            f'height="{bottom - top}"/></clipPath>',
            f'<g clip-path="url(#teeth)"><rect x="10" y="{top}" width="{WIDTH - 20}" '
            f'height="{bottom - top}" fill="#fafafa"/>',
            f'<line x1="{middle}" x2="{middle}" y1="{top}" y2="{bottom}" stroke="{GREEN}" '
            'stroke-dasharray="4 4"/>',
            f'<g fill="#c8c8c8" stroke="#555" transform="translate('
            f'{moving.phase_deg[at_contact] * deg_px:.1f} 0)">'
            f"{moving.moves(moving.phase_deg * deg_px, zeros)}"
            f'<path d="{" ".join(gear)}"/><path d="{aimed}" fill="#5fb39a">{color}</path>'
            f'<rect x="{-WIDTH}" y="{gear_front + TOOTH_PX:.1f}" width="{3 * WIDTH}" height="90"/></g>',
            f'<g fill="#8fbcdb" stroke="#005b8f" transform="translate(0 '
            f'{contact_mm * SLEEVE_MM_PX:.1f})">'
            f"{moving.moves(zeros, moving.travel_mm * SLEEVE_MM_PX)}"
            f'<path d="{" ".join(sleeve)}"/>'
            f'<rect x="{-WIDTH}" y="{front - TOOTH_PX - 190:.1f}" width="{3 * WIDTH}" height="190"/></g>',
            "</g>",
            f'<text x="20" y="{top + 20}" fill="#005b8f" font-weight="600">sleeve</text>',
            f'<text x="20" y="{bottom - 7}" fill="#333" font-weight="600">gear</text>',
        )
    )


def _comb(x: float, front: float, side: int, half: float) -> str:
    """A tooth; side: +1 where its body lies below the front."""
    root, edge = front + side * TOOTH_PX, 4.0
    return (
        f"M{x - half:.1f} {root:.1f}V{front + side * edge:.1f}L{x - half + edge:.1f} {front:.1f}"
        f"H{x + half - edge:.1f}L{x + half:.1f} {front + side * edge:.1f}V{root:.1f}Z"
    )


def _captions(moving: Moving) -> str:
    """What happens, one line at a time; the last one stands where nothing moves."""
    seen, end_ms = moving.seen, float(moving.ms[-1])
    would = "would meet a tooth"
    lines = [
        ("brake and drag bring the gear to the sleeve's speed", INK, float(moving.ms[0]), seen.fired_ms),
        ("fired: tooth is predicted to meet gap when the sleeve arrives", BLUE, seen.fired_ms, seen.aborted_ms),
        (f"newer edges say that it {would}: stopped in flight by the opposite valve", ORANGE,
         seen.aborted_ms, seen.held_ms),
        ("held by friction short of the teeth, until the gap comes", INK, seen.held_ms, seen.again_ms),
        ("fired again", BLUE, seen.again_ms, seen.contact_ms),
        ("tooth meets gap: in gear", GREEN, seen.contact_ms, end_ms),
    ]  # fmt: skip
    made = []
    for k, (words, color, from_ms, to_ms) in enumerate(lines):
        shown = "1" if k == len(lines) - 1 else "0"
        made.append(
            f'<text x="{WIDTH / 2}" y="26" text-anchor="middle" font-size="17" font-weight="600" '
            f'fill="{color}" opacity="{shown}">{words}'
            f"{moving.during('opacity', '0', '1', from_ms, to_ms)}</text>"
        )
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
        f'<line x1="{moving.x(at):.1f}" x2="{moving.x(at):.1f}" y1="{first}" y2="{last}" '
        f'stroke="{GREY}" stroke-dasharray="3 3"/><text x="{moving.x(at):.1f}" y="{first - 10}" '
        f'text-anchor="middle" font-size="13">{name}</text>'
        for name, at in moments.items()
    ]
    now = np.array([moving.x(at) for at in moving.ms])
    contact = moving.x(seen.contact_ms)
    cursor = (
        f'<line x1="0" x2="0" y1="{first - 4}" y2="{last}" stroke="#c00" stroke-width="1.5" '
        f'transform="translate({contact:.1f} 0)">{moving.moves(now, np.zeros(now.size))}</line>'
    )
    scale = [
        f'<text x="{moving.x(at):.1f}" y="{last + 17}" text-anchor="middle" font-size="12" '
        f'fill="{GREY}">{at} ms</text>'
        for at in range(0, int(moving.ms[-1]), 20)
    ]
    return "\n".join([_way(moving), _valves(moving), _phase(moving), *lines, *scale, cursor])


def _line(moving: Moving, ys: Vector) -> str:
    points = " ".join(f"{moving.x(at):.1f},{y:.1f}" for at, y in zip(moving.ms, ys, strict=True))
    return f'<polyline fill="none" stroke="{INK}" stroke-width="2" points="{points}"/>'


def _name(track: str, *words: str) -> str:
    top, bottom = TRACKS[track]
    middle = (top + bottom) / 2 + 5 - 8 * (len(words) - 1)
    return "".join(
        f'<text x="{LEFT - 12}" y="{middle + 16 * k:.0f}" text-anchor="end" font-size="13">{word}</text>'
        for k, word in enumerate(words)
    )


def _way(moving: Moving) -> str:
    top, bottom = TRACKS["sleeve"]
    sleeve = moving.seen.sheet.sleeve
    stroke_mm, contact_mm = sleeve.stroke_m / MM, sleeve.to_contact_m / MM
    teeth = bottom - (bottom - top) * contact_mm / stroke_mm
    return (
        f'<rect x="{LEFT}" y="{top}" width="{RIGHT - LEFT}" height="{teeth - top:.1f}" fill="#e9e9e9"/>'
        f'<text x="{RIGHT - 4}" y="{teeth - 5:.1f}" text-anchor="end" font-size="12" fill="{GREY}">'
        "at the gear's teeth</text>"
        + _line(moving, bottom - (bottom - top) * moving.travel_mm / stroke_mm)
        + _name("sleeve", "way of the", "sleeve")
    )


def _valves(moving: Moving) -> str:
    top, bottom = TRACKS["valves"]
    high = (bottom - top) / 2 - 2
    bars = []
    for lane, (name, color) in enumerate((("towards_coil", BLUE), ("against_coil", ORANGE))):
        on = np.interp(moving.ms, moving.seen.ms, moving.seen.samples[name]) > 0.5
        edges = np.flatnonzero(np.diff(np.concatenate(([0], on.astype(int), [0]))))
        for start, end in edges.reshape(-1, 2).tolist():
            from_x, to_x = (moving.x(moving.ms[min(k, moving.ms.size - 1)]) for k in (start, end))
            y = top + lane * (high + 4)
            bars.append(
                f'<rect x="{from_x:.1f}" y="{y:.1f}" width="{to_x - from_x:.1f}" '
                f'height="{high:.1f}" fill="{color}"/>'
            )
    return "".join(bars) + _name("valves", "valve on,", "opposite valve")


def _phase(moving: Moving) -> str:
    top, bottom = TRACKS["phase"]
    seen = moving.seen
    missed_deg = float(np.interp(seen.missed_ms, moving.ms, moving.phase_deg))
    met_deg = float(np.interp(seen.contact_ms, moving.ms, moving.phase_deg))
    low = min(float(moving.phase_deg.min()), -moving.gap) - 0.5
    high = max(float(moving.phase_deg.max()), moving.gap) + 0.5

    def y(deg: float) -> float:
        return bottom - (bottom - top) * (deg - low) / (high - low)

    bands = [
        f'<rect x="{LEFT}" y="{y(min(high, k * moving.pitch + moving.gap / 2)):.1f}" '
        f'width="{RIGHT - LEFT}" height="{y(max(low, k * moving.pitch - moving.gap / 2)) - y(min(high, k * moving.pitch + moving.gap / 2)):.1f}" '
        'fill="#d5efe4"/>'
        for k in range(-3, 4)
        if k * moving.pitch + moving.gap / 2 > low and k * moving.pitch - moving.gap / 2 < high
    ]
    x, at = moving.x(seen.missed_ms), y(missed_deg)
    cross = (
        f'<path d="M{x - 6:.1f} {at - 6:.1f}l12 12m0 -12l-12 12" stroke="{ORANGE}" stroke-width="3.5"/>'
        f'<text x="{x + 12:.1f}" y="{at + 16:.1f}" font-size="12" fill="#a83f00">'
        "where it would have met</text>"
    )
    dot = (
        f'<circle cx="{moving.x(seen.contact_ms):.1f}" cy="{y(met_deg):.1f}" r="6" fill="{GREEN}" '
        f'stroke="{INK}"/>'
    )
    ys = np.array([y(deg) for deg in moving.phase_deg])
    return "".join([*bands, _line(moving, ys), cross, dot]) + _name("phase", "tooth against", "the gaps")


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(picture(watched_shift()), encoding="utf-8", newline="\n")
