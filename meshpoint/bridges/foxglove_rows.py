"""Time series as Foxglove has them: a topic is a channel of JSON objects with a JSON schema."""

from __future__ import annotations

from typing import Any, Final

from meshpoint.bridges.series import TOPICS, Sample, Signal

NAMED: Final = "_name"
"""Ends the name of a choice's text, beside its number."""
CHOICES: Final = {
    name: [signal for signal in topic.signals if signal.names] for name, topic in TOPICS.items()
}
"""Signals whose numbers have names, by topic."""


def values_of(sample: Sample) -> dict[str, Any]:
    """A row: numbers, and the names of choices."""
    values: dict[str, Any] = dict(sample.values)
    for signal in CHOICES[sample.topic]:
        number = sample.values.get(signal.name)
        values[signal.name + NAMED] = signal.names.get(int(number or 0), "")
    return values


def schema_of(topic: str) -> dict[str, Any]:
    """What its rows are, as a JSON schema."""
    of = TOPICS[topic]
    properties = {signal.name: _property(signal, "number") for signal in of.signals}
    for signal in CHOICES[topic]:
        properties[signal.name + NAMED] = _property(signal, "string")
    return {
        "title": topic, "description": of.comment, "type": "object", "properties": properties,
    }  # fmt: skip


def nanoseconds(time_s: float) -> int:
    """A time as Foxglove has it."""
    return round(time_s * 1e9)


def _property(signal: Signal, kind: str) -> dict[str, str]:
    unit = f" [{signal.unit}]" if signal.unit else ""
    return {"type": kind, "description": f"{signal.comment}{unit}"}
