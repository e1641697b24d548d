"""SIGINT and SIGTERM: the first asks, the second insists."""

import os
import signal
import time

import pytest

from hil.edge.host.clock import MonotonicClock, StopSignal

BOTH = [signal.SIGINT, signal.SIGTERM]


@pytest.mark.parametrize("number", BOTH)
def test_the_first_signal_is_only_noted(number: signal.Signals) -> None:
    with StopSignal() as stop:
        assert stop.received is None
        os.kill(os.getpid(), number)
        assert stop.received is number


@pytest.mark.parametrize("first", BOTH)
@pytest.mark.parametrize("second", BOTH)
def test_the_second_signal_interrupts(first: signal.Signals, second: signal.Signals) -> None:
    with StopSignal() as stop:
        os.kill(os.getpid(), first)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), second)
        assert stop.received is first


def test_the_handlers_before_are_put_back_whatever_happens() -> None:
    before = [signal.getsignal(number) for number in BOTH]
    with pytest.raises(ZeroDivisionError), StopSignal():
        raise ZeroDivisionError
    assert [signal.getsignal(number) for number in BOTH] == before


def test_the_clock_sleeps_to_a_deadline_and_not_past_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = MonotonicClock()
    deadline_ns = clock.now_ns() + 20_000_000
    clock.sleep_until(deadline_ns)
    assert clock.now_ns() >= deadline_ns
    monkeypatch.setattr(time, "sleep", lambda for_s: pytest.fail(f"sleeps {for_s} s for a deadline that is past"))
    clock.sleep_until(deadline_ns - 10_000_000_000)
    clock.sleep_until(clock.now_ns())
