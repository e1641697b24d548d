"""What is made of the kernel's word on an interface, before a run and during one."""

from typing import Any

import pytest

from hil.edge.can.socketcan import Link, LinkError

UP = Link("can0", 3, "can", is_up=True, has_carrier=True, bitrate=500_000, state="ERROR_ACTIVE")
BRING_UP = "ip link set can0 up type can bitrate 500000"


def link(**changes: str | int | None) -> Link:
    return Link(**{name: getattr(UP, name) for name in Link.__slots__} | changes)


@pytest.mark.parametrize("usable", [UP, link(bitrate=None), link(kind="vcan", bitrate=None, state="")])
def test_a_link_that_is_up_at_its_bit_rate_or_has_none_is_taken(usable: Link) -> None:
    usable.require(500_000)
    assert usable.warnings() == ()


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        (link(kind=""), "can0 is not a CAN interface"),
        (link(is_up=False), f"can0 is down; as root: {BRING_UP}"),
        (link(is_up=False, kind="vcan"), "can0 is down; as root: ip link set can0 up"),
        (link(bitrate=250_000), f"can0 runs at 250000 bit/s; as root: ip link set can0 down; {BRING_UP}"),
        (link(state="BUS_OFF"), "can0 is bus-off; fix the bus, then as root: ip link set can0 type can restart"),
    ],
)
def test_any_other_is_refused_with_what_to_do(bad: Link, text: str) -> None:
    with pytest.raises(LinkError) as refused:
        bad.require(500_000)
    assert refused.value.strerror == text


def test_an_interface_that_is_not_there_is_named() -> None:
    with pytest.raises(LinkError, match="there is no interface nosuch0"):
        Link.read("nosuch0")


def test_an_interface_of_another_kind_is_read_like_any() -> None:
    """The loopback interface is there on every host."""
    seen = Link.read("lo")
    assert (seen.name, seen.kind, seen.bitrate, seen.restart_ms, seen.state) == ("lo", "", None, 0, "")


def test_a_kernel_that_restarts_by_itself_and_a_controller_in_trouble_are_warned_of() -> None:
    restarts, passive = link(restart_ms=100, state="ERROR_PASSIVE").warnings()
    assert "after 100 ms (restart-ms)" in restarts
    assert passive == "can0: the CAN controller is error-passive before anything is sent"


@pytest.mark.parametrize(
    ("kind", "flags", "data"),
    [
        ("can", 0x10001, {"can_bittiming": {"bitrate": 500_000}, "can_state": "ERROR_ACTIVE", "can_restart_ms": 0}),
        ("can", 0x10001, {"can_bittiming": {"bitrate": 0}, "can_state": "STOPPED", "can_restart_ms": 100}),
        ("vcan", 0x1, {}),
    ],
)
def test_a_message_of_rtnetlink_is_read(kind: str, flags: int, data: dict[str, Any]) -> None:
    class Message(dict[str, int]):
        def get(self, path: Any, default: Any = None) -> Any:
            if path == ("linkinfo", "kind"):
                return kind
            return data.get(path[-1], default)

    read = Link.of("can0", Message(index=3, flags=flags))
    bitrate = data.get("can_bittiming", {}).get("bitrate") or None
    assert (read.index, read.kind, read.is_up, read.has_carrier) == (3, kind, True, flags > 1)
    assert (read.bitrate, read.restart_ms) == (bitrate, data.get("can_restart_ms", 0))
