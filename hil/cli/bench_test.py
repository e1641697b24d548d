"""Scenarios of `hil test` on a bus, one after the other, each as `hil run` makes it.

A run that trips where no limit expects it, fails or is stopped ends the test: what happened is to be looked at before
pumps move again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rich.console import Console

from hil.bench.acceptance_run import AcceptanceRun, is_end_judged, judge_live
from hil.bench.assembly import Bench
from hil.bench.user_errors import USER_ERRORS
from hil.cli import exit_codes, run_display
from hil.edge.can.bus import BusAddress
from hil.edge.host.clock import StopSignal
from hil.review.judged_scenario import JudgedScenario

LiveWork = Sequence[tuple[Bench, AcceptanceRun, BusAddress]]


def on_bench(console: Console, work: LiveWork, report: Callable[[JudgedScenario], None]) -> int:
    """Run all, or all up to the one that ends the test; the exit code of that one, 0 if there is none.

    report : is called after each, and for each that is not run any more. Raises SettingsError, RunFolderError, BusError
    before the first run; later they are the scenario's error.
    """
    code, why = 0, ""
    with StopSignal() as stop:
        for number, one in enumerate(work):
            if not code and stop.received is not None:
                code, why = exit_codes.BY_SIGNAL[stop.received.name], f"stopped by {stop.received.name}"
            if code:
                report(JudgedScenario(one[0].scenario.scenario.name, not_run=why))
                continue
            try:
                judged, code, why = _one(console, *one)
            except USER_ERRORS as error:
                if number == 0:
                    raise
                judged = JudgedScenario(one[0].scenario.scenario.name, error=str(error))
                code, why = exit_codes.NOT_DONE, "the run before it could not begin"
            report(judged)
    return code


def _one(console: Console, bench: Bench, asked: AcceptanceRun, address: BusAddress) -> tuple[JudgedScenario, int, str]:
    """One run: its verdicts, and the exit code if it ends the test, with the reason for the others."""
    name = bench.scenario.scenario.name
    console.print(f"{name}: on {address.interface} {address.channel}", highlight=False, markup=False)
    try:
        with run_display.live_status(console, with_table=True) as watch:
            judged, status, reason = judge_live(bench, asked, address, watch)
    except KeyboardInterrupt:  # a second signal; the pumps were off before it could get here
        error = "interrupted while the record was being closed"
        return JudgedScenario(name, error=error, folder=asked.out), exit_codes.BY_SIGNAL["SIGINT"], "interrupted"
    if status == "complete" or (status == "tripped" and is_end_judged(bench.scenario.accept)):
        return judged, 0, ""
    code = exit_codes.of_run(status, reason) or exit_codes.NOT_DONE
    return judged, code, f"{name} ended as {status}: {reason}"
