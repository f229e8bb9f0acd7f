"""What an estimator of the layshaft can be asked, whichever it is."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from meshpoint.controller.estimation.crossing_filter import Pressures
from meshpoint.controller.motion.linear_kernels import Vector
from meshpoint.controller.motion.models import LayshaftState, MotionModel
from meshpoint.controller.sensing.wheel_edges import EdgeBatch


class LayshaftModels(NamedTuple):
    """The free layshaft for one step of the splitter."""

    motion: MotionModel
    thesis: Vector
    """A `kernels.Linear`: the thesis's linear model with the data sheet's values."""
    inertia_kgm2: float


class LayshaftTracker(Protocol):
    """Angle, speed and brake pressure of the layshaft at any time near now."""

    @property
    def free(self) -> bool:
        """Whether the model holds: clutch open, main box in neutral, and a speed to begin with."""

    @property
    def model(self) -> MotionModel:
        """The model that holds while free. RuntimeError before it was set."""

    def set_models(self, models: LayshaftModels) -> None:
        """The splitter's step or the brake's law is new."""

    def set_free(self, free: bool, time_us: float, events: list[str]) -> None:
        """The model begins or ceases to hold; what was learned meanwhile is told in `events`."""

    def restart(self) -> None:
        """Tooth numbers were lost: starts anew."""

    def lose_speed(self) -> None:
        """A hole in the edges, or cones that dragged: teeth keep their numbers, the speed not."""

    def edges(self, batch: EdgeBatch, pressures: Pressures) -> None:
        """Takes new edges and measured pressures."""

    def at(self, time_us: float) -> LayshaftState | None:
        """The state at a time; None without a speed, or without an edge for 60 ms."""

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts. Valid only while `free`."""
