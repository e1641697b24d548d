"""`hil doctor`: opens the bus, examines the bench, shows the table. Exit code 4 if a check failed."""

from __future__ import annotations

import resource
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from hil.bench import assembly
from hil.bench.bus_choice import chosen_bus
from hil.cli import result_table
from hil.doctor.check_host import HostFacts, check_host
from hil.doctor.check_link import LinkState, check_lines, check_link
from hil.doctor.examination import Expectations, examine
from hil.edge.can import adapters
from hil.edge.can.bus import BusAddress, BusError, BusPort
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.settings_file import default_config_dir, of_all
from hil.edge.config.shipped import rig_file_in_use
from hil.edge.host import host_facts
from hil.edge.host.clock import MonotonicClock, StopSignal
from hil.probe.bus_probe import Probe
from hil.probe.check_result import Result, failed, has_failed, passed
from hil.wire.contract import Contract

COMMANDS_S = 10
LinkReader = Callable[[str], LinkState | None]


def kernel_link(name: str) -> LinkState | None:
    """State of an interface in the kernel; None if there is none of that name."""
    from hil.edge.can.socketcan import Link, LinkError  # other buses do not need netlink

    try:
        return Link.read(name)
    except LinkError:
        return None


@dataclass(frozen=True)
class DoctorOptions:
    """Options of the command line; None: the rig file's value."""

    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    seconds: float = 5.0
    with_pumps: bool = False
    config_dir: Path | None = None
    rig: str | Path | None = None
    runs: Path = Path("runs")


def run(console: Console, options: DoctorOptions, read_link: LinkReader = kernel_link) -> int:
    """Examine the bench; return the exit code. Raises SettingsError, BusError, InterruptedByUserError."""
    rig, contract, address = bench(options)
    has_link = adapters.find(address.interface).has_kernel_link
    link = read_link(address.channel) if has_link else None
    results = check_link(link, address.channel, address.bitrate, is_socketcan=has_link)
    console.print(
        f"Listening for {options.seconds:g} s, then sending commands of 0 V for about {COMMANDS_S} s.", highlight=False
    )
    results += examined(address, contract, expectations(rig), options)
    results += check_host(read_host_facts(options.runs))
    where = f"{address.interface} {address.channel}"
    console.print(result_table.table(f"hil doctor: {where}", results))
    console.print(result_table.tally(results), highlight=False)
    return result_table.EXIT_FAILED if has_failed(results) else 0


def bench(options: DoctorOptions) -> tuple[Rig, Contract, BusAddress]:
    """Rig, contract and bus address; raises SettingsError, and BusError for an unknown interface."""
    config_dir = options.config_dir or default_config_dir()
    rig = load_rig(rig_file_in_use(options.rig, options.config_dir))
    contract = assembly.load_contract(config_dir / "bench.dbc")
    return rig, contract, chosen_bus(rig, options.interface, options.channel, options.bitrate)


def examined(address: BusAddress, contract: Contract, wants: Expectations, options: DoctorOptions) -> list[Result]:
    """Open the bus, examine the bench, close the bus."""
    try:
        bus = address.open(contract.ids)
    except BusError as error:
        return [
            failed("bus opens", str(error), "check that the adapter is plugged in, its driver loaded, and the link up")
        ]
    with closing(BusPort(bus)) as port, StopSignal() as stop:
        probe = Probe(contract, port, MonotonicClock(), lambda: stop.received.name if stop.received else "")
        with probe:
            results = examine(probe, wants, options.seconds, with_pumps=options.with_pumps)
        lines = check_lines(port.line_counts)
    opens = passed("bus opens", f"{address.interface} {address.channel} at {address.bitrate} bit/s")
    return [opens, lines, *results]


def expectations(rig: Rig) -> Expectations:
    """The rig file's values for the bench."""
    return Expectations(
        model=rig.tank_model,
        lag_s=rig.lags_s,
        pumps=rig.pump_path,
        sensors=rig.level_sensors,
        rate_V_s=rig.pumps.rate_V_s,
        noise_V=of_all(rig.sensors.noise_V),
        level_max_cm=rig.safety.level_max_cm,
        errors_per_s_max=rig.safety.errors_per_s_max,
        echo_age_max_s=rig.safety.echo_age_max_s,
        echo_tolerance_V=rig.safety.echo_tolerance_V,
    )


def read_host_facts(runs: Path) -> HostFacts:
    """Values of this computer."""
    free, folder = host_facts.disk_free(runs)
    return HostFacts(
        clock_step_s=host_facts.clock_step_s(),
        rtprio=host_facts.limit(resource.RLIMIT_RTPRIO),
        memlock_bytes=host_facts.limit(resource.RLIMIT_MEMLOCK),
        is_nice=host_facts.has_capability(host_facts.CAP_SYS_NICE),
        may_lock=host_facts.has_capability(host_facts.CAP_IPC_LOCK),
        governors=host_facts.governors(),
        disk_free_bytes=free,
        disk_folder=str(folder),
    )
