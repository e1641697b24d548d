"""The link: state of a SocketCAN interface in the kernel; lines of an slcan adapter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from hil.probe.check_result import Result, failed, not_checked, passed, warned
from hil.wire.rejections import lines_rejected


class LinkState(Protocol):
    """State of a link. bitrate, restart_ms : None if unknown, as for vcan."""

    @property
    def name(self) -> str:
        """Name of the interface."""
        ...

    @property
    def is_up(self) -> bool:
        """Whether it is up."""
        ...

    @property
    def state(self) -> str:
        """The kernel's name: up, down, ERROR_ACTIVE, ERROR_PASSIVE, BUS_OFF...; "" if there is none."""
        ...

    @property
    def bitrate(self) -> int | None:
        """Bit/s."""
        ...

    @property
    def restart_ms(self) -> int | None:
        """Time in ms after which the kernel ends a bus-off; 0: never."""
        ...


WARNING_STATES = ("error-warning", "error-passive")
FAILED_STATES = ("bus-off", "stopped", "sleeping")


def check_link(state: LinkState | None, channel: str, bitrate: int, *, is_socketcan: bool) -> list[Result]:
    """Whether the link is up, without errors, at the right bit rate, and not restarted automatically after bus-off."""
    names = ("link state", "link bit rate", "link restart-ms")
    if not is_socketcan:
        return [not_checked(name, "not a SocketCAN bus") for name in names]
    if state is None:
        advice = f"plug the adapter in and load its driver; then: ip link set {channel} up type can bitrate {bitrate}"
        return [failed(names[0], f"there is no interface {channel}", advice)]
    return [
        _check_state(state, bitrate),
        _check_bitrate(state, bitrate),
        _check_restart(state),
    ]


def check_lines(counts: Mapping[str, int]) -> Result:
    """What an slcan adapter refused, and what was rejected of its lines. counts : empty for any other bus."""
    check = "adapter lines"
    if not counts:
        return not_checked(check, "not an slcan adapter")
    found = lines_rejected(counts)
    if not found:
        return passed(check, "none rejected, no command refused")
    if any(name.startswith("rejected_") and number for name, number in counts.items()):
        advice = (
            "the adapter sends lines that are not slcan, or its serial line loses bytes: baud rate (-c DEVICE@BAUD), "
            "firmware, other programs on its port"
        )
        return failed(check, found, advice)
    return warned(check, found, "the adapter could not send: is another node on the bus, at the same bit rate?")


def _check_state(state: LinkState, bitrate: int) -> Result:
    check, word = "link state", state.state.lower().replace("_", "-") or ("up" if state.is_up else "down")
    if not state.is_up:
        return failed(check, f"{state.name} is {word}", f"ip link set {state.name} up type can bitrate {bitrate}")
    if word in FAILED_STATES:
        advice = f"fix the bus, then: ip link set {state.name} down && ip link set {state.name} up"
        return failed(check, f"{state.name} is {word}", advice)
    if word in WARNING_STATES:
        return warned(check, f"{state.name} is {word}", "check cable, termination and bit rate")
    return passed(check, f"{state.name} is {word}")


def _check_bitrate(state: LinkState, bitrate: int) -> Result:
    check = "link bit rate"
    if state.bitrate is None:
        return not_checked(check, f"{state.name} reports none")
    if state.bitrate != bitrate:
        advice = f"ip link set {state.name} down; ip link set {state.name} up type can bitrate {bitrate}"
        return failed(check, f"{state.bitrate} bit/s, rig.toml says {bitrate}", advice)
    return passed(check, f"{state.bitrate} bit/s")


def _check_restart(state: LinkState) -> Result:
    check = "link restart-ms"
    if state.restart_ms is None:
        return not_checked(check, f"{state.name} reports none")
    if state.restart_ms:
        advice = (
            f"after bus-off, the cause must be found first: ip link set {state.name} type can restart-ms 0 (link down)"
        )
        return warned(check, f"{state.restart_ms} ms", advice)
    return passed(check, "0: bus-off stays until the link is restarted by hand")
