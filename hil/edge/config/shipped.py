"""Scenarios, campaigns and rigs that come with the package, by name: `paper` stands for `config/scenarios/paper.toml`.

A path that exists is always taken as it is. A bare name (no slash; `.toml` may be left out) that is no path is looked
up in the configuration folder in use, then in the one that is shipped.
"""

from __future__ import annotations

from pathlib import Path

from hil.edge.config.settings_file import SettingsError, default_config_dir

RIG_TOML = "rig.toml"
SCENARIOS, CAMPAIGNS, RIGS, BENCHMARKS = "scenarios", "campaigns", "rigs", "benchmarks"


def find_scenario(scenario: str | Path, config_dir: Path | None = None) -> Path:
    """The file of a scenario given by path or by shipped name.

    Raises SettingsError that lists the shipped names when there is neither.
    """
    return _find(scenario, SCENARIOS, config_dir)


def find_campaign(campaign: str | Path, config_dir: Path | None = None) -> Path:
    """The file of a campaign given by path (a folder, too) or by shipped name; or by a scenario's name.

    Raises SettingsError that lists the shipped names when there is neither.
    """
    return _find(campaign, CAMPAIGNS, config_dir, SCENARIOS)


def find_rig(rig: str | Path, config_dir: Path | None = None) -> Path:
    """The file of a rig given by path or by shipped name.

    Raises SettingsError that lists the shipped names when there is neither.
    """
    return _find(rig, RIGS, config_dir)


def rig_file_in_use(rig: str | Path | None, config_dir: Path | None = None) -> Path:
    """The rig file that is named, see `find_rig`; without a name `rig.toml` of the configuration folder in use."""
    return (config_dir or default_config_dir()) / RIG_TOML if rig is None else find_rig(rig, config_dir)


def find_benchmark(benchmark: str | Path, config_dir: Path | None = None) -> Path:
    """The file of a benchmark given by path or by shipped name.

    Raises SettingsError that lists the shipped names when there is neither.
    """
    return _find(benchmark, BENCHMARKS, config_dir)


def shipped_names(kind: str, config_dir: Path | None = None) -> tuple[str, ...]:
    """Names of all files in a folder of the configuration in use and of the shipped one. kind : its name."""
    return tuple(sorted({file.stem for folder in _folders(kind, config_dir) for file in folder.glob("*.toml")}))


def _find(given: str | Path, kind: str, config_dir: Path | None, *also: str) -> Path:
    path = Path(given)
    if path.exists():
        return path
    is_name = path.name == str(given)
    if is_name:
        name = path.name.removesuffix(".toml")
        folders = [folder for one in (kind, *also) for folder in _folders(one, config_dir)]
        for file in (folder / f"{name}.toml" for folder in folders):
            if file.is_file():
                return file
    shipped = ", ".join(shipped_names(kind, config_dir))
    what = "no such file, and no shipped name" if is_name else "can't be read: No such file or directory"
    raise SettingsError(f"{given}: {what}; shipped {kind}: {shipped}")


def _folders(kind: str, config_dir: Path | None) -> list[Path]:
    """The configuration in use first."""
    folders = [*([] if config_dir is None else [config_dir]), default_config_dir()]
    return [folder / kind for folder in folders]
