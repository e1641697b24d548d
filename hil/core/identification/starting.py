"""A start for the fit, nearer to the rig than its file may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hil.core.identification.parameters import Choice, RigModel
from hil.core.identification.records import LevelRecord


def starting_point(
    records: Sequence[LevelRecord], start: RigModel, choices: Mapping[str, Choice], groups: Sequence[str]
) -> RigModel:
    """The rig from which the fit starts."""
    del records, choices, groups
    return start
