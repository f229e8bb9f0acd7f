"""What a node may send at once: its burst, however long it was quiet before."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.bus.local.throttle import BURST_BYTES, FAIR_BYTES_S, Allowance

FRAME_BYTES = 80


@pytest.mark.parametrize("quiet_s", [0.0, 1.0, 3600.0])
def test_a_node_that_was_quiet_may_send_one_burst_and_no_more(quiet_s: float) -> None:
    allowance = Allowance(0.0)
    sent = 0
    while allowance.spend(FRAME_BYTES, quiet_s):
        sent += FRAME_BYTES
    assert sent == BURST_BYTES // FRAME_BYTES * FRAME_BYTES


@given(st.lists(st.tuples(st.floats(0.0, 10.0), st.integers(1, 50_000)), max_size=200))
def test_within_its_share_a_node_sends_at_most_a_burst_and_what_time_earns(
    sends: list[tuple[float, int]],
) -> None:
    """From any moment on, not from the first alone."""
    allowance, now_s = Allowance(0.0), 0.0
    within: list[tuple[float, int]] = []
    for pause_s, sent_bytes in sends:
        now_s += pause_s
        if allowance.spend(sent_bytes, now_s):
            within.append((now_s, sent_bytes))
    for k, (since_s, _) in enumerate(within):
        total = 0
        for at_s, sent_bytes in within[k:]:
            total += sent_bytes
            assert total <= BURST_BYTES + (at_s - since_s) * FAIR_BYTES_S + 1.0


def test_a_node_that_has_flooded_is_heard_again_after_two_bursts_of_time() -> None:
    allowance = Allowance(0.0)
    for _ in range(1000):
        allowance.spend(FRAME_BYTES * 100, 0.0)
    assert not allowance.spend(FRAME_BYTES, 0.5 * BURST_BYTES / FAIR_BYTES_S)
    assert allowance.spend(FRAME_BYTES, 2.0 * BURST_BYTES / FAIR_BYTES_S)
