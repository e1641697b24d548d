"""Checks of the computer and of a SocketCAN link, by facts; what is read from /sys and /proc, from made-up trees."""

import resource
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any

import pytest

from hil.cli.doctor_command import kernel_link
from hil.doctor.check_host import HostFacts, check_host
from hil.doctor.check_link import check_link
from hil.edge.host import host_facts
from hil.probe.check_result import Result, Verdict

PASS, WARN, FAIL, NOT_CHECKED = Verdict.PASS, Verdict.WARN, Verdict.FAIL, Verdict.NOT_CHECKED
MIB, GIB = 2**20, 2**30
GOOD = HostFacts(1e-9, 80.0, inf, False, False, ("performance", "performance"), 20 * GIB, "/data")


def by_name(results: list[Result]) -> dict[str, Result]:
    return {result.check: result for result in results}


def test_a_good_host_passes() -> None:
    assert {result.verdict for result in check_host(GOOD)} == {PASS}


@pytest.mark.parametrize(
    ("facts", "check", "verdict"),
    [
        ({"clock_step_s": 1e-6}, "monotonic clock", PASS),
        ({"clock_step_s": 4e-3}, "monotonic clock", WARN),
        ({"rtprio": 0.0}, "real-time priority", WARN),
        ({"rtprio": 0.0, "is_nice": True}, "real-time priority", PASS),
        ({"rtprio": 1.0}, "real-time priority", PASS),
        ({"memlock_bytes": 8.0 * MIB}, "locked memory", WARN),
        ({"memlock_bytes": 8.0 * MIB, "may_lock": True}, "locked memory", PASS),
        ({"memlock_bytes": 512.0 * MIB}, "locked memory", PASS),
        ({"governors": ("performance", "powersave")}, "CPU governor", WARN),
        ({"governors": ()}, "CPU governor", NOT_CHECKED),
        ({"disk_free_bytes": GIB}, "disk space", PASS),
        ({"disk_free_bytes": GIB - 1}, "disk space", WARN),
        ({"disk_free_bytes": 64 * MIB}, "disk space", WARN),
        ({"disk_free_bytes": 64 * MIB - 1}, "disk space", FAIL),
    ],
)
def test_the_host_is_judged(facts: dict[str, Any], check: str, verdict: Verdict) -> None:
    result = by_name(check_host(replace(GOOD, **facts)))[check]
    assert result.verdict is verdict
    assert bool(result.advice) is (verdict in (WARN, FAIL))


@dataclass(frozen=True)
class Link:
    """As rtnetlink would tell."""

    name: str = "can0"
    is_up: bool = True
    state: str = "ERROR_ACTIVE"
    bitrate: int | None = 500_000
    restart_ms: int | None = 0


@pytest.mark.parametrize(
    ("link", "check", "verdict"),
    [
        (Link(), "link state", PASS),
        (Link(), "link bit rate", PASS),
        (Link(), "link restart-ms", PASS),
        (Link(is_up=False, state="down"), "link state", FAIL),
        (Link(state="BUS_OFF"), "link state", FAIL),
        (Link(state="ERROR_PASSIVE"), "link state", WARN),
        (Link(state="error-warning"), "link state", WARN),
        (Link(state=""), "link state", PASS),
        (Link(bitrate=250_000), "link bit rate", FAIL),
        (Link(bitrate=None), "link bit rate", NOT_CHECKED),
        (Link(restart_ms=100), "link restart-ms", WARN),
        (Link(restart_ms=None), "link restart-ms", NOT_CHECKED),
        (None, "link state", FAIL),
    ],
)
def test_the_link_is_judged(link: Link | None, check: str, verdict: Verdict) -> None:
    result = by_name(check_link(link, "can0", 500_000, is_socketcan=True))[check]
    assert result.verdict is verdict
    assert bool(result.advice) is (verdict in (WARN, FAIL))


def test_a_bus_that_is_no_socketcan_has_no_link() -> None:
    results = check_link(None, "/dev/ttyACM0", 500_000, is_socketcan=False)
    assert {result.verdict for result in results} == {NOT_CHECKED}


def test_an_interface_that_is_not_there_is_none() -> None:
    assert kernel_link("can97") is None


def test_loopback_is_a_link_that_tells_no_bit_rate() -> None:
    link = kernel_link("lo")
    assert link is not None
    assert (link.name, link.bitrate) == ("lo", None)


def test_governors_are_read_from_sys(tmp_path: Path) -> None:
    assert host_facts.governors(tmp_path) == ()
    for core, name in enumerate(("performance", "powersave")):
        folder = tmp_path / f"devices/system/cpu/cpu{core}/cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text(name + "\n")
    assert host_facts.governors(tmp_path) == ("performance", "powersave")


@pytest.mark.parametrize(("bit", "has"), [(host_facts.CAP_IPC_LOCK, True), (host_facts.CAP_SYS_NICE, False)])
def test_capabilities_are_read_from_proc(tmp_path: Path, bit: int, has: bool) -> None:
    file = tmp_path / "status"
    file.write_text(f"Name:\tx\nCapPrm:\t0000000000000000\nCapEff:\t{1 << host_facts.CAP_IPC_LOCK:016x}\n")
    assert host_facts.has_capability(bit, file) is has
    assert host_facts.has_capability(bit, tmp_path / "none") is False


def test_disk_space_is_that_of_the_folder_that_will_be_made(tmp_path: Path) -> None:
    free, folder = host_facts.disk_free(tmp_path / "runs" / "today")
    assert folder == tmp_path
    assert free > 0


def test_limits_and_clock_are_this_machine_s() -> None:
    assert 0.0 < host_facts.clock_step_s() <= 1e-3
    assert host_facts.limit(resource.RLIMIT_MEMLOCK) > 0.0


def test_a_limit_is_the_soft_one_and_infinite_where_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only that it is not negative used to be asserted, which holds for any limit."""
    monkeypatch.setattr(resource, "getrlimit", lambda which: (which, 99))
    assert host_facts.limit(7) == 7.0
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, 99))
    assert host_facts.limit(7) == inf
