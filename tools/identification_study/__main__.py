"""`python -m tools.identification_study --kind basic|rich|rigs --seeds N --first-seed S [--keep FILE]`.

basic: the default rig, k, gamma, a within 20 %, lags within 50 % of the file. rich: beyond that curves, dead zones,
datums, sensors with gains and offsets of their own, and waves of 2 mV; ten readings by a ruler near the top. rigs:
those of config/rigs, with a ruler. Always started from the default file, with the cross-sections and heights of the
rig's own tanks. Prints for each parameter the errors, how often the 95 % interval covered and the RMS of error over
standard deviation; and how often the structure was right.

--keep FILE keeps what each rig gave. The same command goes on with the rigs that the file does not have: after a
change of the code begin with another file.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from tools.identification_study.cases import RIGS, CaseSpec, run_case
from tools.identification_study.outcome import Outcome, Store, outcome_of
from tools.identification_study.tables import parameter_table, summary


def studied(spec: CaseSpec, store: Store) -> Outcome:
    """The outcome of a case: the stored one, or a new one."""
    known = store[spec.key]
    if known is None:
        case = run_case(spec)
        known = outcome_of(spec.key, spec.name, case.truth, case.found, spec.expected, case.duration_s)
        store.add(known)
    structure = ", ".join(known.structure) or "basic"
    print(f"{known.name}: {known.refusal or structure} ({known.duration_s:.1f} s)", flush=True)
    return known


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.identification_study",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--kind", choices=("basic", "rich", "rigs"), default="basic")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--wire", action="store_true", help="the experiment of hil identify --emulator; not for rigs")
    parser.add_argument("--turbulence", type=float, default=0.0, help="cm3/sqrt(s), of basic rigs")
    parser.add_argument("--wave", type=float, default=0.0, help="V, of basic rigs")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="keep the outcome of each rig, one line each")
    options = parser.parse_args(arguments)
    console, store = Console(width=110), Store(options.keep)
    specs = [
        CaseSpec(options.kind, seed, options.turbulence, options.wave, rig, options.wire and not rig)
        for seed in range(options.first_seed, options.first_seed + options.seeds)
        for rig in (RIGS if options.kind == "rigs" else ("",))
    ]
    outcomes = [studied(spec, store) for spec in specs]
    console.print(parameter_table(outcomes))
    for line in summary(outcomes):
        console.print(line, highlight=False)
    if options.kind == "rigs":
        for one in outcomes[: len(RIGS)]:
            console.print(f"{one.name}: structure {', '.join(one.structure) or 'basic'}")
            console.print(parameter_table([one]))


if __name__ == "__main__":
    main()
