"""The controller that a run folder describes, from its copies of the configuration; or with other choices."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from hil.bench import assembly
from hil.bench.assembly import Bench
from hil.core.controller import ControllerConfig
from hil.edge.config.settings_file import SettingsError
from hil.edge.config.shipped import find_rig
from hil.edge.record.manifest import Manifest
from hil.edge.record.run_folder import RunFolder
from hil.replay.frame_log import ReplayError

MAX_SHOWN = 4


@dataclass(frozen=True, slots=True)
class WhatIf:
    """What is used in place of what was recorded; None: as recorded."""

    rig: str | None = None
    detector: str | None = None
    law: str | None = None

    def __bool__(self) -> bool:
        return any(choice is not None for choice in (self.rig, self.detector, self.law))

    def __str__(self) -> str:
        chosen = {"rig": self.rig, "detector": self.detector, "law": self.law}
        return ", ".join(f"{name} {choice}" for name, choice in chosen.items() if choice is not None)


@dataclass(frozen=True, slots=True)
class RecordedController:
    """doubts : where today's program reads the recorded settings differently."""

    bench: Bench
    config: ControllerConfig
    clear_trip: bool
    doubts: tuple[str, ...]


@contextmanager
def recorded_controller(folder: RunFolder, what_if: WhatIf) -> Iterator[RecordedController]:
    """Raises ReplayError, SettingsError. The files that a law may read are there while the context is open."""
    manifest = folder.manifest()
    settings = manifest.plan.settings
    if "scenario" not in settings or "rig" not in settings or not manifest.plan.copies:
        raise ReplayError(f"{folder.path}: run.json has no copies of a scenario and a rig: it is no run of a scenario")
    with TemporaryDirectory(prefix="hil-replay-") as name:
        place = Path(name)
        try:
            scenario = _written(folder, place, manifest.plan.copies)
            controller = _controller(place, scenario, manifest, what_if)
        except SettingsError as error:
            text = str(error).replace(f"{place}/", f"{folder.manifest_path}, copy of ")
            raise SettingsError(f"{text}{_hint(settings, what_if)}") from None
        except (KeyError, TypeError, AttributeError) as error:
            what = f"{type(error).__name__}: {error}"
            raise ReplayError(
                f"{folder.manifest_path}: settings: these are not the settings of a run ({what})"
            ) from None
        yield controller


def named_controller(
    scenario: str | Path, config_dir: Path | None, what_if: WhatIf, duration_s: float | None
) -> RecordedController:
    """The controller of a scenario on a rig, for a log. Raises SettingsError."""
    bench = assembly.load(scenario, config_dir, rig=what_if.rig, detector=what_if.detector, law=what_if.law)
    return RecordedController(bench, assembly.controller_config(bench, duration_s), clear_trip=False, doubts=())


def _written(folder: RunFolder, place: Path, copies: Mapping[str, str]) -> Path:
    """The copies as files below `place`; the scenario's path."""
    for name, text in copies.items():
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts:
            raise ReplayError(f"{folder.manifest_path}: copies: {name!r} is no name of a file of the configuration")
        file = place / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    scenarios = sorted(place.glob("scenarios/*.toml"))
    if len(scenarios) != 1 or not {"rig.toml", "bench.dbc"} <= copies.keys():
        raise ReplayError(f"{folder.manifest_path}: copies: there must be rig.toml, bench.dbc and one scenario")
    return scenarios[0]


def _controller(place: Path, scenario: Path, manifest: Manifest, what_if: WhatIf) -> RecordedController:
    recorded = manifest.plan.settings
    control, options = recorded["scenario"]["control"], recorded.get("options", {})
    bench = assembly.load(
        scenario,
        place,
        rig=place / "rig.toml" if what_if.rig is None else find_rig(what_if.rig),
        design=control.get("design"),
        detector=what_if.detector or recorded["scenario"]["diagnosis"]["method"],
        law=what_if.law or control.get("law"),
    )
    duration_s = options.get("duration_s")
    config = assembly.controller_config(bench, duration_s)
    attended_s = float(options.get("attended_s", 0.0))
    config = replace(
        config,
        limits=replace(config.limits, attended_s=attended_s),
        waits_for_clearing=manifest.plan.mode == "live" and not isfinite(config.duration_s),
    )
    doubts = [] if what_if else list(_changed(bench, recorded))
    if not options:
        doubts.append("an older record: whether --duration, --clear-trip or --attended were given is not in it")
    return RecordedController(bench, config, bool(options.get("clear_trip", False)), tuple(doubts))


def _changed(bench: Bench, recorded: Mapping[str, Any]) -> Iterator[str]:
    """Settings that today's program reads from the recorded files as something else than it did then."""
    today = {"rig": bench.rig.model_dump(mode="json"), "scenario": bench.scenario.model_dump(mode="json")}
    before = dict(_flat({name: recorded[name] for name in today}))
    now = dict(_flat(today))
    other = [
        f"{key} = {now[key]!r}, recorded {before[key]!r}" for key in now if key in before and now[key] != before[key]
    ]
    other += [f"{key} = {now[key]!r}, not known then" for key in now if key not in before]
    other += [f"{key}, not known any more" for key in before if key not in now]
    if other:
        more = f" and {len(other) - MAX_SHOWN} more" if len(other) > MAX_SHOWN else ""
        yield f"today's program reads the recorded settings differently: {'; '.join(other[:MAX_SHOWN])}{more}"


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else str(key))
    else:
        yield name, value


def _hint(settings: Mapping[str, Any], what_if: WhatIf) -> str:
    """What to do about a run with an object of the user's own, whose class's name stands in the record."""
    scenario = settings["scenario"]
    law, method = scenario["control"].get("law", ""), scenario["diagnosis"].get("method", "")
    if what_if.law is None and law and not str(law).islower():
        return f"; {law} was an object of a script, which no record has: choose with --law"
    if what_if.detector is None and method and not str(method).islower():
        return f"; {method} was an object of a script, which no record has: choose with --detector"
    return ""
