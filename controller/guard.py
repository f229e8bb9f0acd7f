"""The guard: reads the finished valve frame with its own decode and passes it or blocks it.

Separate on purpose from everything that decides: it shares no state with the sequence and no code
with the codec, so a mistake there does not reach a valve. Each rule is a row of a table. The rows
here are those an upshift can break; numbers are those of the design's list of forbidden commands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

ACTION_BYTES: Final = slice(3, 6)
FRAME_LENGTH: Final = 48
BRAKE: Final = 0
PAIRS: Final = ((1, 2), (3, 4), (5, 6), (7, 8))
"""The two valves of one sleeve: splitter, first/second, crawl/third, range."""
MAIN_VALVES: Final = (3, 4, 5, 6)
ON_NOW: Final = 1
ON_AT: Final = 3
VALVES: Final = 9
DRIVEN_BITS: Final = sum(1 << 2 * valve for valve in range(VALVES))
"""The bit that both ON_NOW and ON_AT have and neither off has."""
NEUTRAL_M: Final = 1.5e-3
CLUTCH_OPEN_SHARE: Final = 0.05


class Seen(NamedTuple):
    """What the guard is told each step, straight from the sensor frames."""

    now_us: int
    first_second_m: float
    crawl_third_m: float
    clutch_closed: float
    positions_valid: bool


class Wish(NamedTuple):
    """A decoded command: which valves are to be driven, now or at their time."""

    driven: tuple[bool, ...]


NOTHING: Final = Wish((False,) * VALVES)


@dataclass
class GuardState:
    """The guard's own memory: since when each valve has been commanded on."""

    on_since_us: list[int | None] = field(default_factory=lambda: [None] * VALVES)
    latched: bool = False


Rule = Callable[[Wish, Seen], bool]


def both_valves_of_a_sleeve(wish: Wish, _seen: Seen) -> bool:
    """Row 1."""
    return any(wish.driven[a] and wish.driven[b] for a, b in PAIRS)


def two_sleeves_of_the_main_box(wish: Wish, seen: Seen) -> bool:
    """Row 2: both commanded, or one commanded while the other is not proven neutral."""
    first_second = wish.driven[3] or wish.driven[4]
    crawl_third = wish.driven[5] or wish.driven[6]
    if first_second and crawl_third:
        return True
    other_m = seen.crawl_third_m if first_second else seen.first_second_m
    return (first_second or crawl_third) and abs(other_m) > NEUTRAL_M


def brake_against_the_driveline(wish: Wish, seen: Seen) -> bool:
    """Row 5: brake with a gear engaged or engaging, or with the clutch closed."""
    if not wish.driven[BRAKE]:
        return False
    in_mesh = max(abs(seen.first_second_m), abs(seen.crawl_third_m)) > NEUTRAL_M
    engaging = any(wish.driven[valve] for valve in MAIN_VALVES)
    return in_mesh or engaging or seen.clutch_closed > CLUTCH_OPEN_SHARE


def outputs_on_unknown_positions(wish: Wish, seen: Seen) -> bool:
    """Row 12: any output before valid positions have been seen, or after they were lost."""
    return any(wish.driven) and not seen.positions_valid


class Row(NamedTuple):
    """One rule: its number in the design's list, whether it latches, and the test."""

    number: int
    latches: bool
    forbids: Rule


ROWS: Final = (
    Row(1, True, both_valves_of_a_sleeve),
    Row(2, True, two_sleeves_of_the_main_box),
    Row(5, False, brake_against_the_driveline),
    Row(12, False, outputs_on_unknown_positions),
)


class Guard:
    """Judges finished frames; `max_on_us` is row 7, a valve's longest time on."""

    def __init__(self, max_on_us: int) -> None:
        self._max_on_us = max_on_us
        self._state = GuardState()
        self.blocks = 0
        self.blocked_row: int | None = None

    def passes(self, payload: bytes, seen: Seen) -> bool:
        """Whether the frame may go out. A latched guard passes only frames that drive nothing, and
        one such frame clears the latch: the sequence has taken its command back."""
        wish = decode(payload)
        if wish is NOTHING:
            # Every row is about a driven valve.
            self._state.latched, self.blocked_row = False, None
            self._state.on_since_us = [None] * VALVES
            return True
        self.blocked_row = self._judge(wish, seen)
        if self.blocked_row is None and self._state.latched:
            self.blocked_row = 1
        if self.blocked_row is not None:
            self.blocks += 1
            self._state.on_since_us = [None] * VALVES
            return False
        for valve, driven in enumerate(wish.driven):
            since = self._state.on_since_us[valve]
            self._state.on_since_us[valve] = (since or seen.now_us) if driven else None
        return True

    def _judge(self, wish: Wish, seen: Seen) -> int | None:
        for row in ROWS:
            if row.forbids(wish, seen):
                self._state.latched |= row.latches
                return row.number
        for valve, since in enumerate(self._state.on_since_us):
            held_us = 0 if since is None else seen.now_us - since
            if wish.driven[valve] and held_us > self._max_on_us:
                return 7
        return None


def decode(payload: bytes) -> Wish:
    """The guard's own reading of the frame. ValueError where it is not a valve command's length."""
    if len(payload) != FRAME_LENGTH:
        raise ValueError(f"valve command of {len(payload)} bytes, allowed is {FRAME_LENGTH}")
    actions = int.from_bytes(payload[ACTION_BYTES], "little")
    if not actions & DRIVEN_BITS:
        return NOTHING
    return Wish(tuple((actions >> 2 * valve) & 3 in (ON_NOW, ON_AT) for valve in range(VALVES)))
