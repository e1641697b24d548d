"""`hil conformance`: tests the nodes of a bench; table, JSON; exit code 4 if one does not conform."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console

from hil.cli import doctor_command, result_table
from hil.conformance.suite import Plan, conforms, run_suite
from hil.edge.can.bus import BusAddress, BusPort
from hil.edge.config.settings_file import SettingsError
from hil.edge.host.clock import MonotonicClock, StopSignal
from hil.edge.record.file_writing import write_atomically
from hil.probe.bus_probe import Probe
from hil.probe.check_result import Result
from hil.version import __version__
from hil.wire.contract import Contract


@dataclass(frozen=True)
class ConformanceOptions:
    """Options of the command line; None: the rig file's value. node : pump, level or both."""

    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    node: str = "both"
    with_pumps: bool = False
    json_file: Path | None = None
    power_cycle_s: float = 0.0
    config_dir: Path | None = None


def run(console: Console, options: ConformanceOptions) -> int:
    """Run the tests; return the exit code. Raises SettingsError, BusError, InterruptedByUserError."""
    rig, contract, address = doctor_command.bench(
        doctor_command.DoctorOptions(options.interface, options.channel, options.bitrate, config_dir=options.config_dir)
    )
    plan = Plan(
        pump_node=options.node in ("pump", "both"),
        level_node=options.node in ("level", "both"),
        with_pumps=options.with_pumps,
        sensor_range_V=rig.sensors.range_V,
        power_cycle_s=options.power_cycle_s,
    )
    _refuse_to_overwrite(options.json_file)
    console.print("Testing; this takes about a minute.", highlight=False)
    results = _tested(address, contract, plan, lambda text: console.print(text, style="bold", highlight=False))
    is_good = conforms(results)
    console.print(result_table.table(f"hil conformance: {address.interface} {address.channel}", results))
    console.print(f"{result_table.tally(results)}: {'conforms' if is_good else 'does not conform'}", highlight=False)
    if options.json_file is not None:
        _write(options.json_file, address, contract, options, results)
    return 0 if is_good else result_table.EXIT_FAILED


def _tested(address: BusAddress, contract: Contract, plan: Plan, ask: Callable[[str], None]) -> list[Result]:
    with closing(BusPort(address.open(contract.ids))) as port, StopSignal() as stop:
        probe = Probe(contract, port, MonotonicClock(), lambda: stop.received.name if stop.received else "")
        with probe:
            return run_suite(probe, plan, ask)


def _refuse_to_overwrite(file: Path | None) -> None:
    if file is not None and (file.exists() or not file.parent.is_dir()):
        why = "exists already" if file.exists() else f"there is no folder {file.parent}"
        raise SettingsError(f"--json {file}: {why}")


def _write(
    file: Path, address: BusAddress, contract: Contract, options: ConformanceOptions, results: list[Result]
) -> None:
    report = {
        "conforms": conforms(results),
        "version": __version__,
        "contract": f"{contract.fingerprint:#010x}",
        "bus": asdict(address),
        "node": options.node,
        "with_pumps": options.with_pumps,
        "results": [asdict(result) for result in results],
    }
    write_atomically(file, json.dumps(report, indent=2) + "\n")
