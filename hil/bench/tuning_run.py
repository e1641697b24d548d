"""`hil tune` without a terminal: candidates, their runs over the benchmark's machinery, margins, choice, files."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.bench import benchmark_run
from hil.bench.benchmark_run import BenchmarkOptions, PreparedBenchmark
from hil.bench.design_figures import process_figures
from hil.bench.designs import DESIGNS
from hil.bench.law_choices import STATE_FEEDBACK
from hil.bench.loop_margins import loop_margins
from hil.bench.tuning_candidates import candidates
from hil.campaigns.benchmark_spec import BenchmarkInfo, BenchmarkSpec, DetectorEntry, LawEntry, RigEntry
from hil.campaigns.row import Row
from hil.campaigns.standing import Standings
from hil.campaigns.standings import standings
from hil.campaigns.store import Store
from hil.campaigns.tuning_choice import Candidate, Robustness, Trial, judged
from hil.core.errors import HilError
from hil.core.gain_design import gain_matrix
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.rig_file_writer import read_rig_text, replace_rig_file, rig_text_with
from hil.edge.config.scenario_file import load_scenario
from hil.edge.config.settings_file import SettingsError, default_config_dir, validated
from hil.edge.config.shipped import find_rig, find_scenario
from hil.edge.record.file_writing import write_atomically

SCENARIO = "tuning"
STEP, LOSS, REST = "step", "loss", "rest"


class NotWrittenError(HilError):
    """The rig file stays as it is; the message says why."""


@dataclass(frozen=True)
class TuneOptions:
    """How to tune; None: as the files have it. law, law_options : of [control]. count : candidates beside the present.

    spread : the rigs of the runs are drawn within this share of the file. noise_max_V : None: 1.1 times the present.
    """

    rig: str | Path | None = None
    config_dir: Path | None = None
    scenario: str | Path | None = None
    count: int = 9
    seeds: int = 3
    first_seed: int = 40_001
    spread: float = 0.03
    noise_max_V: float | None = None
    out: Path | None = None
    processes: int | None = None


@dataclass(frozen=True)
class PreparedTuning:
    """A tuning whose settings are checked. trials : the candidates."""

    rig_path: Path
    rig: Rig
    law: str
    candidates: tuple[Candidate, ...]
    benchmark: PreparedBenchmark


@dataclass(frozen=True)
class TuningResult:
    """What a tuning came to. trials : in the candidates' order."""

    prepared: PreparedTuning
    trials: tuple[Trial, ...]

    @property
    def chosen(self) -> Trial | None:
        """The chosen one; None if none can be."""
        return next((trial for trial in self.trials if trial.is_chosen), None)

    @property
    def present(self) -> Trial:
        """The options in force."""
        return next(trial for trial in self.trials if trial.candidate.is_present)


def prepare_tuning(options: TuneOptions) -> PreparedTuning:
    """Read and check everything; nothing is run or written. Raises SettingsError."""
    config_dir = (options.config_dir or default_config_dir()).resolve()
    rig_file = None if options.rig is None else find_rig(options.rig, options.config_dir).resolve()
    rig_path = rig_file or config_dir / "rig.toml"
    rig = load_rig(rig_path)
    scenario_path = find_scenario(options.scenario or SCENARIO, options.config_dir)
    scenario = load_scenario(scenario_path)
    missing = {REST, STEP, LOSS} - {window.name for window in scenario.window}
    if missing:
        raise SettingsError(f"{scenario_path}: has no window {', '.join(sorted(missing))}")
    choice = scenario.control
    found = candidates(rig, choice.law, choice.options, options.count, str(rig_path))
    about = {
        "name": f"tune_{rig_path.stem}",
        "scenarios": (str(scenario_path),),
        "seeds": options.seeds,
        "first_seed": options.first_seed,
        "noise_window": REST,
    }
    spec = BenchmarkSpec(
        benchmark=validated(BenchmarkInfo, about, str(rig_path)),
        law=tuple(LawEntry(label=one.label[:60], control=dict(one.control), rig=dict(one.rig)) for one in found),
        detector=(DetectorEntry(label="as in the scenario"),),
        rig=(
            RigEntry(
                label=rig_path.stem,
                file=None if rig_file is None else str(rig_file),
                emulator={"parameter_spread": options.spread},
            ),
        ),
    )
    made = BenchmarkOptions(options.out, options.config_dir, processes=options.processes)
    benchmark = benchmark_run.prepare_spec(spec, rig_path, (scenario_path,), config_dir, made)
    return PreparedTuning(rig_path, rig, choice.law, found, benchmark)


def tune(
    prepared: PreparedTuning, store: Store | None, noise_max_V: float | None, on_row: Callable[[Row], None]
) -> TuningResult:
    """Make the runs that are missing, and choose."""
    runs = benchmark_run.run_missing(prepared.benchmark, store, on_row)
    found = standings(runs, REST)
    trials = [_trial(prepared, one, found) for one in prepared.candidates]
    return TuningResult(prepared, judged(trials, prepared.rig.control.period_s, noise_max_V))


def write_tuning(tuning: TuningResult, folder: Path) -> tuple[Path, ...]:
    """Write `tuning.json`, `tuning.csv` and `report.html` and say where they are."""
    from hil.campaigns.tuning_report import render  # draws: a second that others need not wait for

    lines = [_flat(trial) for trial in tuning.trials]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    files = {
        folder / "tuning.json": json.dumps([_plain(asdict(one)) for one in tuning.trials], indent=2) + "\n",
        folder / "tuning.csv": text.getvalue(),
        folder / "report.html": render(tuning.prepared.rig_path.name, tuning.prepared.law, tuning.trials),
    }
    for path, content in files.items():
        write_atomically(path, content)
    return tuple(files)


def write_choice(tuning: TuningResult, now: datetime) -> Path:
    """Put the chosen options into the rig file. Returns the path of the dated copy of the old file.

    Raises NotWrittenError when there is nothing to write there; IncompleteRecordError when it can't be written.
    """
    path, chosen = tuning.prepared.rig_path, tuning.chosen
    if tuning.prepared.law != STATE_FEEDBACK:
        raise NotWrittenError(f"{path} stays: options of the law {tuning.prepared.law!r} belong to a scenario")
    if chosen is None:
        raise NotWrittenError(f"{path} stays: no candidate meets the rule")
    if chosen.candidate.is_present:
        raise NotWrittenError(f"{path} stays: no candidate is better than what it says")
    text = rig_text_with(read_rig_text(path), chosen.candidate.values)
    return replace_rig_file(path, text, now)


def _trial(prepared: PreparedTuning, candidate: Candidate, found: Standings) -> Trial:
    label = candidate.label[:60]
    own = {one.course.window: one for one in found.of_courses if one.entrant.law == label}
    endings: dict[str, int] = {}
    for one in own.values():
        for cause, count in one.endings.items():
            endings[cause] = max(count, endings.get(cause, 0))
    step, loss = own.get(STEP), own.get(LOSS)
    return Trial(
        candidate=candidate,
        step_iae_Vs=None if step is None else _both(step.iae_Vs),
        loss_iae_Vs=None if loss is None else _both(loss.iae_Vs),
        noise_V=None if step is None else step.noise_V,
        overshoot_V=None if step is None else step.worst_overshoot_V,
        endings=endings,
        robustness=_robustness(prepared, candidate) if prepared.law == STATE_FEEDBACK else None,
    )


def _robustness(prepared: PreparedTuning, candidate: Candidate) -> Robustness:
    control = prepared.rig.control.model_copy(
        update={name: tuple(v) if isinstance(v, list) else v for name, v in candidate.rig["control"].items()}
    )
    rig = prepared.rig.model_copy(update={"control": control})
    linear = process_figures(rig).linear
    K = gain_matrix(DESIGNS.find("rig", "").make(rig).gains(linear))
    found = loop_margins(linear, K, rig.lags_s, rig.pump_path.delay_s, control.period_s)
    lost = tuple(name for name, is_stable in found.losses.items() if not is_stable)
    return Robustness(found.gain_up, found.gain_down, found.delay_s, found.distance, lost, found.spread)


def _both(pair: tuple[float | None, float | None]) -> float | None:
    first, second = pair
    return None if first is None or second is None else first + second


def _flat(trial: Trial) -> dict[str, Any]:
    plain = asdict(trial)
    candidate, robust = plain.pop("candidate"), plain.pop("robustness") or {}
    values = {"label": candidate["label"], "values": json.dumps(candidate["values"])}
    endings = {"endings": "; ".join(f"{cause} {count}" for cause, count in plain.pop("endings").items())}
    lost = {"lost": ", ".join(robust.pop("lost", ()))}
    return {**values, **plain, **endings, **robust, **lost}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
