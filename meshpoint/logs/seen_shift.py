"""A change of gear that a log shows, whoever commanded it."""

from __future__ import annotations

from typing import Any, NamedTuple


class SeenShift(NamedTuple):
    """One. Times in us, of the sensor clock (32 bits) or since the log's first frame."""

    from_gear: int
    to_gear: int
    left_us: int
    there_us: int
    driven_us: int | None = None
    """When the valve towards the new gear was first seen driven; to within a frame, 10 ms."""
    contact: str | None = None
    """`gap` or `tooth` at first contact; None where the sleeves' ways do not show it."""
    attempts: int = 0

    @property
    def left_s(self) -> float:
        """When the old gear was left."""
        return self.left_us * 1e-6

    @property
    def there_s(self) -> float:
        """When the new one was there."""
        return self.there_us * 1e-6

    @property
    def open_ms(self) -> float:
        """How long there was no gear."""
        return (self.there_s - self.left_s) * 1e3

    def to_json(self) -> dict[str, Any]:
        """As `replay --sensors --json` has it."""
        return {
            "from": self.from_gear,
            "to": self.to_gear,
            "left_s": round(self.left_s, 4),
            "there_s": round(self.there_s, 4),
            "open_ms": round(self.open_ms, 1),
        }
