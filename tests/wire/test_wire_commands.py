"""Echoes of commands: which are settled, which are lost, how long the oldest has waited."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.wire.command_sender import CommandSender
from tests.narrowing import not_none
from tests.wire.wire_bench import CONTRACT, MS, go


def sender_with(count: int, period_ns: int = 100 * MS) -> CommandSender:
    sender = CommandSender(CONTRACT)
    for number in range(count):
        sender.encode(go(number % 10 + 0.5, 1.0), number * period_ns)
    return sender


def test_nothing_sent_waits_for_nothing() -> None:
    sender = CommandSender(CONTRACT)
    assert sender.unechoed_s(10**12) == 0.0
    assert sender.echo(3, 7) is None


def test_the_oldest_unechoed_command_makes_the_age() -> None:
    sender = sender_with(3)
    assert sender.unechoed_s(250 * MS) == pytest.approx(0.25)
    sender.echo(0, 1)
    assert sender.unechoed_s(250 * MS) == pytest.approx(0.15)
    sender.echo(2, 3)
    assert sender.unechoed_s(250 * MS) == 0.0


def test_an_echo_names_the_command_that_it_stands_for() -> None:
    sender = sender_with(18)
    echoed = sender.echo(1, 18)
    assert echoed is not None
    assert (echoed.number, echoed.counter, echoed.voltage_V, echoed.sent_ns) == (17, 1, (7.5, 1.0), 1700 * MS)
    assert sender.echo(1, 18) is echoed  # status frames repeat it
    assert sender.lost == 0


def test_a_replay_expects_the_echo_of_what_was_sent_then() -> None:
    """Number, counter and time stay those of the command that takes its place."""
    sender = sender_with(3)
    sender.replace_last((1.5, 2.5), enable=False)
    echo = sender.echo(2, 3)
    assert echo is not None
    assert (echo.number, echo.counter, echo.sent_ns) == (2, 2, 200 * MS)
    assert (echo.voltage_V, echo.enable) == ((1.5, 2.5), False)


def test_an_echo_of_nothing_that_was_sent_settles_nothing() -> None:
    sender = sender_with(3)
    assert sender.echo(9, 40) is None
    assert sender.unechoed_s(300 * MS) == pytest.approx(0.3)
    sender.echo(1, 2)
    assert sender.echo(9, 40) is None
    assert sender.unechoed_s(300 * MS) == pytest.approx(0.1)


def test_a_node_that_accepted_nothing_since_its_boot_echoes_nothing() -> None:
    sender = sender_with(1)
    assert sender.echo(0, 0) is None
    assert sender.unechoed_s(50 * MS) > 0.0
    assert sender.echo(0, 1) is not None


def test_the_modulo_of_the_accepted_count_is_not_a_node_without_commands() -> None:
    sender = sender_with(2)
    sender.echo(0, 255)
    assert not_none(sender.echo(1, 0)).number == 1
    assert sender.lost == 0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.booleans(), min_size=20, max_size=600), st.integers(0, 255), st.integers(1, 3))
def test_lost_commands_are_counted_through_every_wrap(arrives: list[bool], before: int, every: int) -> None:
    """A node that has accepted `before` commands in earlier runs gets some of ours; statuses echo the last one."""
    sender, accepted, echo, first, last = CommandSender(CONTRACT), before, None, None, None
    waiting = 0
    for number, comes in enumerate(arrives):
        sender.encode(go(), number * 100 * MS)
        # the echo tells 15 commands apart: a longer silence trips the run long before
        comes = comes or waiting >= 10
        waiting = 0 if comes else waiting + 1
        if comes:
            accepted, echo = accepted + 1, number % 16
            last = number
        if echo is not None and (comes or number % every == 0) and sender.echo(echo, accepted % 256) and first is None:
            first = last, accepted
    if first is not None:
        assert last is not None
        assert first[0] is not None
        assert sender.lost == (last - first[0]) - (accepted - first[1])


def test_a_long_silence_is_counted_once_it_ends() -> None:
    sender = sender_with(1)
    sender.echo(0, 1)
    for number in range(1, 31):
        sender.encode(go(), number * 100 * MS)
        sender.echo(0, 1)
    assert sender.unechoed_s(3000 * MS) > 1.0
    sender.echo(30 % 16, 2)
    assert sender.lost == 29
    assert sender.unechoed_s(3000 * MS) == 0.0


@pytest.mark.parametrize("accepted_before", [0, 1, 77, 255])
def test_a_status_of_an_earlier_run_does_not_look_like_lost_commands(accepted_before: int) -> None:
    """Its echo may name our first command before that has arrived; 255 commands used to be reported lost."""
    sender = sender_with(1)
    sender.echo(0, accepted_before)
    sender.echo(0, (accepted_before + 1) % 256)
    sender.encode(go(), 100 * MS)
    sender.echo(1, (accepted_before + 2) % 256)
    assert sender.lost == 0


def test_an_echo_alone_tells_fifteen_commands_apart() -> None:
    sender = sender_with(40)
    assert sender.unechoed_s(4000 * MS) == pytest.approx(4.0)
    assert not_none(sender.echo(25 % 16, 26)).number == 25
    assert sender.unechoed_s(4000 * MS) == pytest.approx(1.4)


@pytest.mark.parametrize("late", [1, 15, 16, 17, 31, 100])
def test_a_line_that_was_held_up_loses_nothing(late: int) -> None:
    """At 100 Hz sixteen commands are sent in 160 ms; the echo of the first was taken for that of the seventeenth, and
    sixteen commands were called lost."""
    sender = sender_with(1, 10 * MS)
    assert not_none(sender.echo(0, 1)).number == 0
    for number in range(1, late + 2):
        sender.encode(go(), number * 10 * MS)
    assert not_none(sender.echo(1, 2)).number == 1
    assert sender.unechoed_s((late + 2) * 10 * MS) == pytest.approx(late * 0.01)
    assert not_none(sender.echo((late + 1) % 16, late + 2)).number == late + 1
    assert (sender.lost, sender.unechoed_s(10**12)) == (0, 0.0)


def test_the_age_of_an_unechoed_command_has_no_bound_that_the_period_sets() -> None:
    """At 100 Hz it used to stay at 0.15 s, below what trips."""
    sender = sender_with(1, 10 * MS)
    sender.echo(0, 1)
    for number in range(1, 101):
        sender.encode(go(), number * 10 * MS)
        assert not_none(sender.echo(0, 1)).number == 0
    assert sender.unechoed_s(1010 * MS) == pytest.approx(1.0)


@pytest.mark.parametrize("lost", [1, 5, 14])
def test_an_echo_after_lost_commands_counts_them(lost: int) -> None:
    sender = sender_with(1, 10 * MS)
    sender.echo(0, 1)
    for number in range(1, lost + 2):
        sender.encode(go(), number * 10 * MS)
    assert not_none(sender.echo((lost + 1) % 16, 2)).number == lost + 1
    assert sender.lost == lost
