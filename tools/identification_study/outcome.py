"""What one rig of the study gave, as plain numbers, and a file that keeps it: one line of JSON for each rig."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hil.core.identification.result import Identification
from tools.identification_study.truth import Truth


@dataclass(frozen=True)
class Estimated:
    """An identified parameter: true value, estimate, its 95 % interval and standard deviation."""

    true: float
    value: float
    low: float
    high: float
    sd: float
    unit: str

    @property
    def is_covered(self) -> bool:
        """Whether the interval contains the true value."""
        return self.low <= self.true <= self.high


@dataclass(frozen=True)
class Outcome:
    """One rig. key : the case and how it was made. expected : the right structure; None: it is not known."""

    key: str
    name: str
    refusal: str
    structure: tuple[str, ...]
    expected: tuple[str, ...] | None
    holdout_rmse_V: float
    duration_s: float
    parameters: Mapping[str, Estimated] = field(default_factory=dict)

    @property
    def is_structure_right(self) -> bool:
        """Whether the extensions found are those that the rig has."""
        return self.expected is not None and set(self.structure) == set(self.expected)

    def largest_share(self) -> float:
        """Largest error of k, gamma and a, as a share of the true value."""
        return max(
            abs(one.value / one.true - 1.0) for name, one in self.parameters.items() if name[:-1] in ("k", "gamma", "a")
        )


def outcome_of(
    key: str, name: str, truth: Truth, found: Identification, expected: tuple[str, ...] | None, duration_s: float
) -> Outcome:
    """An identification beside its truth."""
    return Outcome(
        key=key,
        name=name,
        refusal=found.refusal,
        structure=found.structure,
        expected=expected,
        holdout_rmse_V=max(found.holdout_rmse_V),
        duration_s=duration_s,
        parameters={
            one.name: Estimated(truth.value(one.name), one.value, one.low, one.high, one.sd, one.unit)
            for one in found.parameters
            if one.status == "identified"
        },
    )


class Store:
    """Outcomes in a file, by their keys; without a file, of this call alone."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._known = {} if path is None or not path.exists() else {one.key: one for one in _read(path)}

    def __getitem__(self, key: str) -> Outcome | None:
        return self._known.get(key)

    def add(self, outcome: Outcome) -> None:
        """Keep one more, at once."""
        self._known[outcome.key] = outcome
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")


def _read(path: Path) -> Iterator[Outcome]:
    for line in path.read_text(encoding="utf-8").splitlines():
        row: dict[str, Any] = json.loads(line)
        row["structure"] = tuple(row["structure"])
        row["expected"] = None if row["expected"] is None else tuple(row["expected"])
        row["parameters"] = {name: Estimated(**one) for name, one in row["parameters"].items()}
        yield Outcome(**row)
