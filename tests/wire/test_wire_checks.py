"""One identifier's checks by themselves, at the limits that the contract names."""

from dataclasses import fields

import pytest

from hil.wire import frame_check
from hil.wire.frame_check import FrameCheck, Rejection, is_plain
from tests.wire.wire_bench import CONTRACT, MS, NAMES, frame, message

ID = CONTRACT.frames["LowerLevels"].frame_id
SILENCE_NS = 150 * MS


def check(name: str = "LowerLevels") -> frame_check.FrameCheck:
    return FrameCheck(CONTRACT.frames[name])


def begun(counter: int, at_ns: int = 1000 * MS) -> frame_check.FrameCheck:
    one = check()
    assert not isinstance(one.admit(frame("LowerLevels", counter), at_ns), Rejection)
    return one


def verdict(one: frame_check.FrameCheck, counter: int, at_ns: int) -> frame_check.Rejection | None:
    admitted = one.admit(frame("LowerLevels", counter), at_ns)
    return admitted if isinstance(admitted, Rejection) else None


def test_the_rules_are_those_of_the_contract() -> None:
    assert (frame_check.RESYNCHRONISE_NS, frame_check.MAX_COUNTER_STEP) == (150_000_000, 8)


@pytest.mark.parametrize("counter", range(16))
@pytest.mark.parametrize("at_ns", [0, 1, 149 * MS, 10**12])
def test_the_first_frame_is_taken_whatever_its_counter_and_time(counter: int, at_ns: int) -> None:
    one = check()
    assert (one.counter, one.accepted_ns, one.lost, one.refused_run) == (-1, 0, 0, 0)
    assert verdict(one, counter, at_ns) is None
    assert (one.counter, one.accepted_ns, one.lost, one.refused_run) == (counter, at_ns, 0, 0)


@pytest.mark.parametrize("last", [0, 3, 15])
@pytest.mark.parametrize("step", range(16))
def test_steps_of_the_counter(last: int, step: int) -> None:
    one = begun(last)
    found = verdict(one, (last + step) % 16, 1000 * MS + SILENCE_NS)
    if 1 <= step <= 8:
        assert found is None
        assert (one.counter, one.lost, one.refused_run) == ((last + step) % 16, step - 1, 0)
        assert one.accepted_ns == 1000 * MS + SILENCE_NS
    else:
        assert found is (Rejection.DUPLICATE if step == 0 else Rejection.OLD)
        assert (one.counter, one.lost, one.refused_run) == (last, 0, 1)
        assert one.accepted_ns == 1000 * MS


@pytest.mark.parametrize("step", range(16))
def test_after_a_silence_any_counter_is_taken_and_one_that_stands_still_is_doubted(step: int) -> None:
    one = begun(3)
    assert verdict(one, 3, 1001 * MS) is Rejection.DUPLICATE
    assert verdict(one, (3 + step) % 16, 1000 * MS + SILENCE_NS + 1) is None
    assert (one.counter, one.lost) == ((3 + step) % 16, 0)
    assert one.refused_run == (0 if step else 2)


def test_losses_add_up() -> None:
    one = begun(0)
    assert verdict(one, 3, 1020 * MS) is None
    assert verdict(one, 5, 1040 * MS) is None
    assert one.lost == 3


def test_every_refusal_makes_the_run_longer_but_those_of_another_kind() -> None:
    one = begun(0)
    bad_crc = frame("LowerLevels", 1)
    bad_crc.data[6] ^= 1
    for number, (bad, cause) in enumerate(
        [
            (message(ID, bytes(6)), Rejection.LENGTH),
            (message(ID, bytes(8)), Rejection.LENGTH),
            (bad_crc, Rejection.CRC),
            (frame("LowerLevels", 1, Level1=10.2402), Rejection.RANGE),
            (frame("LowerLevels", 0), Rejection.DUPLICATE),
            (frame("LowerLevels", 15), Rejection.OLD),
        ],
        1,
    ):
        assert one.admit(bad, 1010 * MS) is cause
        assert one.refused_run == number
    for kind in ("is_extended_id", "is_remote_frame", "is_error_frame", "is_fd"):
        odd = frame("LowerLevels", 1)
        assert is_plain(odd)
        setattr(odd, kind, True)
        assert not is_plain(odd)
        assert one.admit(odd, 1010 * MS) is Rejection.KIND
    assert one.refused_run == 6
    assert (one.counter, one.accepted_ns, one.lost) == (0, 1000 * MS, 0)
    assert verdict(one, 1, 1020 * MS) is None
    assert one.refused_run == 0


@pytest.mark.parametrize("name", NAMES)
def test_every_byte_counts_for_the_crc(name: str) -> None:
    good = frame(name, 1)
    for byte in range(len(good.data)):
        bad = frame(name, 1)
        bad.data[byte] ^= 0x10
        assert check(name).admit(bad, 0) is Rejection.CRC
    decoded = check(name).admit(good, 0)
    assert not isinstance(decoded, Rejection)
    assert decoded["Counter"] == 1


def test_causes_have_their_names_and_checks_no_room_for_more() -> None:
    assert [str(cause) for cause in Rejection] == [
        "error_frame", "kind", "unknown_id", "length", "crc", "duplicate", "old", "range",
    ]  # fmt: skip
    one = check()
    assert [field.name for field in fields(one)] == ["spec", "counter", "accepted_ns", "lost", "refused_run"]
    with pytest.raises(AttributeError):
        one.more = 1  # type: ignore[attr-defined]  # that there is none is what is shown
