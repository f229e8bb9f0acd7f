"""The memory of the main shaft's crossing-time filter (`swing_filter`)."""

from __future__ import annotations

from typing import Annotated, Final

from meshpoint.controller.estimate.crossing_layout import BATCHES_KEPT, FilterMemory
from meshpoint.controller.models.swing import (
    SWING_MODEL_WORDS,
    SWING_STATES,
    SwingModel,
    SwingState,
    SwingStep,
)
from meshpoint.kernels.records import WORD_BYTES, Over, Records, Vector, layout_of


class SwingSnapshot:
    """A copy of the filter's state, to go back to when late edges arrive."""

    time_us: float
    state: SwingState
    p: Annotated[Vector, SWING_STATES, SWING_STATES]
    noise_scale: float


SWING_SNAPSHOT_WORDS: Final = layout_of(SwingSnapshot).itemsize // WORD_BYTES


class SwingFilter:
    """As `crossing_layout.Filter`, with the states of a shaft that swings. No pressure is
    measured; the field is there because both filters are set up alike."""

    time_us: float
    state: SwingState
    p: Annotated[Vector, SWING_STATES, SWING_STATES]
    noise_scale: float

    # Parameters.
    noise_adaptation: float
    edge_time_s: float
    tooth_rad: float
    pressure_sd_pa: float
    gate_sd: float
    model: SwingModel

    # Results and working memory.
    squares: float
    count: float
    log_variance: float
    gated_in_a_row: int
    held: int
    next: int
    step: SwingStep
    gain: Annotated[Vector, SWING_STATES]
    ring: Annotated[Records[SwingSnapshot], BATCHES_KEPT]

    x: Annotated[Vector, Over("state"), SWING_STATES]
    motion: Annotated[Vector, Over("model"), SWING_MODEL_WORDS]
    nis: Annotated[Vector, Over("squares"), 2]
    snapshot: Annotated[Vector, Over("time_us"), SWING_SNAPSHOT_WORDS]
    snapshots: Annotated[Vector, Over("ring"), BATCHES_KEPT, SWING_SNAPSHOT_WORDS]


SWING_FILTER: Final = layout_of(SwingFilter)


def swing_memory() -> FilterMemory:
    """The memory of a main shaft's filter."""
    return FilterMemory(SWING_FILTER)
