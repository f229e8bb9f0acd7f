"""Where the energy of a plant has come from and gone to."""

from __future__ import annotations

from typing import NamedTuple


class Energy(NamedTuple):
    """The balance since power-up, J: what was put in = what was lost + the change of what is
    stored."""

    put_in: float
    brake: float
    drag: float
    road: float
    rubbing: float
    impacts: float
    twisting: float
    climbed: float
    kinetic: float
    """Of everything that turns; and of twisted shafts."""

    @property
    def lost(self) -> float:
        """Everything that became heat."""
        return self.brake + self.drag + self.road + self.rubbing + self.impacts + self.twisting
