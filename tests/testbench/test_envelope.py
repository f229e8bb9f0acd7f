"""A long signal drawn with few points: no peak is lost, and memory is bounded."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from meshpoint.replays.envelope import MOST_SPANS, Envelope


@given(st.lists(st.tuples(st.floats(0.0, 50.0), st.floats(-1e4, 1e4)), min_size=1, max_size=60))
def test_least_and_greatest_value_are_drawn_however_long_it_is(
    steps: list[tuple[float, float]],
) -> None:
    envelope, at_s, taken = Envelope(), 0.0, []
    for passed_s, value in steps:
        at_s += passed_s
        envelope.take(at_s, value)
        taken.append(value)
    times, values = envelope.points()
    drawn = [value for value in values if value is not None]
    assert min(drawn) == round(min(taken), 2)
    assert max(drawn) == round(max(taken), 2)
    assert times == sorted(times)
    assert times[-1] <= at_s + envelope.span_s
    assert len(drawn) <= 2 * MOST_SPANS


def test_where_nothing_came_the_line_is_broken() -> None:
    envelope = Envelope()
    for at_s in (0.0, 0.01, 5.0):
        envelope.take(at_s, 1.0)
    assert envelope.points()[1] == [1.0, 1.0, None, 1.0]
