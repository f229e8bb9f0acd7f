"""A sensor wheel on a shaft that turns with an estimated one by an exact ratio.

The input shaft is geared to the layshaft through the splitter, the propeller shaft to the main
shaft through the range. The wheel's edges count as edges of the estimated shaft, but for the offset
between the wheels (`fusion_kernels`), which the filter estimates; its own teeth are learned as
those of any wheel.
"""

from __future__ import annotations

from collections.abc import Sequence

from meshpoint.controller.estimation.crossing_filter import CrossingFilter, GearedEdges, Pressures
from meshpoint.controller.estimation.swing_filter import LAYSHAFT_FILTER, FilterKind
from meshpoint.controller.estimation.teeth import WheelTeeth
from meshpoint.controller.motion.kernels import THETA
from meshpoint.controller.records import RecordMemory, Vector
from meshpoint.controller.sensing.sensor_clock import SensorClockEstimate
from meshpoint.controller.sensing.wheel_edges import MOST_RAD_S2, NO_EDGES, EdgeFrame, WheelEdges
from meshpoint.controller.settings import CrossingFilterTuning
from meshpoint.gearbox.sheet import Wheel


class GearedWheel:
    """Its edges of this step, its teeth, and its ratio to the estimated shaft."""

    def __init__(
        self,
        name: str,
        wheel: Wheel,
        tuning: CrossingFilterTuning,
        most_rad_s2: float = MOST_RAD_S2,
        kind: FilterKind = LAYSHAFT_FILTER,
    ) -> None:
        self.name = name
        self._edges = WheelEdges.of(wheel, most_rad_s2)
        self.teeth = WheelTeeth(wheel.teeth, tuning, wheel.missing, kind)
        self._batch = NO_EDGES
        self._scale: float | None = None
        self._moved = True
        self._broken = 0

    def read(
        self,
        risen: Sequence[EdgeFrame],
        fallen: Sequence[EdgeFrame],
        clock: SensorClockEstimate,
        now_us: int,
    ) -> None:
        """This step's frames, rising and falling."""
        self._batch = self._edges.read(risen, fallen, clock, now_us)
        if self._edges.broken != self._broken:
            self._broken = self._edges.broken
            self.teeth.lose_numbers()
            self._moved = True

    def restart(self) -> None:
        """Times jumped: tooth numbers start anew."""
        self._edges.restart()

    def set_ratio(self, scale: float | None, dragged: bool) -> None:
        """Angle of the estimated shaft over that of this one; None while no gear joins the two."""
        self._edges.set_dragged(dragged)
        if scale != self._scale:
            self._scale, self._moved = scale, True

    def edges_for(self, shaft: CrossingFilter) -> GearedEdges | None:
        """New edges as angles of the estimated shaft; None without any. Makes the filter forget the
        offset if it has changed."""
        if self._moved:
            shaft.lose_offset()
            self._moved = False
        batch, scale, teeth = self._batch, self._scale, self.teeth
        if scale is None or not batch.time_us.size:
            return None
        edges = teeth.edges(batch, teeth.place(batch))
        edges[1] *= scale
        return GearedEdges(edges, scale * teeth.sd_rad)

    def learn(
        self,
        shaft: CrossingFilter,
        start_p: Vector,
        pressures: Pressures,
        switches: Vector,
        model: RecordMemory,
    ) -> None:
        """Adds new edges to the window in which the wheel's teeth are learned. A window begins once
        the offset is known; start_p: covariance of the shaft's state at its beginning."""
        batch, scale, learner, offset = self._batch, self._scale, self.teeth.learner, shaft.offset
        if scale is None:
            return
        if learner.running:
            learner.take(batch, self.teeth.place(batch), pressures, switches, model, scale)
        elif offset is not None:
            x = shaft.x.copy()
            x[THETA] += offset[0]
            learner.begin(shaft.time_us, x, start_p)

    def end_window(self, events: list[str]) -> None:
        """The shaft is no longer free."""
        line = self.teeth.end_window()
        if line is not None:
            events.append(f"{self.name} {line}")
