"""What error frames say: every class bit alone, several at once, and those that say nothing known."""

import pytest

from hil.wire.error_frames import DESCRIPTIONS, ErrorKind, read

QUIET = bytes(8)


@pytest.mark.parametrize(
    ("bit", "kind"),
    [
        (0x1, "tx_timeout"),
        (0x2, "lost_arbitration"),
        (0x8, "protocol_violation"),
        (0x10, "transceiver"),
        (0x20, "no_ack"),
        (0x40, "bus_off"),
        (0x80, "bus_error"),
        (0x100, "restarted"),
    ],
)
def test_each_class_has_its_kind(bit: int, kind: str) -> None:
    assert read(bit, QUIET) == (ErrorKind(kind),)


@pytest.mark.parametrize(
    ("detail", "kinds"),
    [
        (0x01, ("overflow",)),
        (0x02, ("overflow",)),
        (0x04, ("error_warning",)),
        (0x08, ("error_warning",)),
        (0x10, ("error_passive",)),
        (0x20, ("error_passive",)),
        (0x40, ("error_active",)),
        (0x21, ("overflow", "error_passive")),
    ],
)
def test_the_state_of_the_controller_stands_in_the_payload(detail: int, kinds: tuple[str, ...]) -> None:
    assert read(0x4, bytes([0, detail, 0, 0, 0, 0, 0, 0])) == tuple(map(ErrorKind, kinds))


def test_several_classes_are_all_read() -> None:
    assert read(0x4 | 0x8 | 0x80, b"\0\x10") == (ErrorKind.PROTOCOL, ErrorKind.BUS_ERROR, ErrorKind.PASSIVE)


@pytest.mark.parametrize(("classes", "data"), [(0, QUIET), (0x200, QUIET), (0x4, QUIET), (0x4, b""), (0x4, b"\x10")])
def test_what_says_nothing_known_is_still_an_error_frame(classes: int, data: bytes) -> None:
    assert read(classes, data) == (ErrorKind.OTHER,)


def test_every_kind_has_words() -> None:
    assert set(DESCRIPTIONS) == set(ErrorKind)
