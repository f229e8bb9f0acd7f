"""Ending by a signal."""

import asyncio
import os
import signal

import pytest

from meshpoint.bus.signals import stop_on_signals


@pytest.mark.asyncio
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_the_first_signal_asks_for_the_end_and_the_next_acts_as_usual(
    number: signal.Signals,
) -> None:
    usual = signal.getsignal(number)
    stop = asyncio.Event()
    with stop_on_signals(stop):
        assert signal.getsignal(number) is not usual
        os.kill(os.getpid(), number)
        await asyncio.wait_for(stop.wait(), 5.0)
        assert signal.getsignal(number) is usual
    assert signal.getsignal(number) is usual


@pytest.mark.asyncio
async def test_a_terminal_and_the_process_above_may_both_ask_for_the_end() -> None:
    stop = asyncio.Event()
    with stop_on_signals(stop):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.wait_for(stop.wait(), 5.0)
