"""The interface of the layshaft's estimators."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from meshpoint.controller.measure.gearbox_view import PressureSamples
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import LayshaftState, MotionModel
from meshpoint.kernels.records import Vector


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
        """Takes new models, after a change of the splitter or of the brake's law."""

    def set_free(self, free: bool, time_us: float, events: list[str]) -> None:
        """The free model begins or ceases to apply; lines on what was learned are added to
        `events`."""

    def restart(self) -> None:
        """Tooth numbers were lost: starts anew."""

    def lose_speed(self) -> None:
        """The speed is lost, by missing edges or by a synchroniser; teeth keep their numbers."""

    def edges(self, batch: EdgeBatch, pressures: PressureSamples) -> None:
        """Takes new edges and measured pressures."""

    def at(self, time_us: float) -> LayshaftState | None:
        """The state at a time; None without a speed, or without an edge for 60 ms."""

    def drag_nm(self, omega_rad_s: float) -> float:
        """Torque that brakes the free layshaft at a speed, the brake's left out (Nm, positive)."""

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts. Valid only while `free`."""
