"""A sender of sensor frames and the controller's receiver, for the tests of the link."""

from __future__ import annotations

from meshpoint.dbc import Frame, Node
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import GearboxSensors

CYCLE_US = 10_000


def sensor_frames(count: int, start: int = 0) -> list[Frame]:
    """Frames of GearboxSensors with counters from `start` on; each carries its number as a time."""
    transmitter = Transmitter(Node.GEARBOX_IO)
    frames = [
        transmitter.encode(GearboxSensors(sample_time_us=number)) for number in range(start + count)
    ]
    return frames[start:]


def controller() -> Receiver:
    return Receiver(Node.TRANSMISSION_CONTROL)


def verdicts(receiver: Receiver, frames: list[Frame]) -> list[FrameVerdict]:
    return [receiver.receive(frame).verdict for frame in frames]
