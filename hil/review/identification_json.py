"""`identification.json`: what an identification found, for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import isfinite
from typing import Any

from hil.core.identification.improvement import MIN_IMPROVEMENT, improvement
from hil.core.identification.result import Identification
from hil.version import __version__

FORMAT = 1
"""Of identification.json."""

DIGITS = 10
"""Significant digits of a number."""


def as_json(identification: Identification, duration_s: float, notes: Sequence[str] = (), trouble: str = "") -> str:
    """The file's text. Numbers that are not known, or not finite, are null.

    duration_s : of all records together. notes, trouble : of the rig file, see `hil.edge.config.identified_rig`.
    """
    better = improvement(identification)
    content = {
        "format": FORMAT,
        "hil": __version__,
        "refusal": identification.refusal,
        "parameters": {
            one.name: {
                "value": _number(one.value),
                "low": _number(one.low),
                "high": _number(one.high),
                "unit": one.unit,
                "was": _number(one.was),
                "status": one.status,
            }
            for one in identification.parameters
        },
        "null_directions": [
            {"names": list(one.names), "weights": [_number(weight) for weight in one.weights], "text": one.text}
            for one in identification.null_directions
        ],
        "structure": list(identification.structure),
        "noise_V": [_number(one) for one in identification.model.noise_V],
        "holdout_rmse_V": [_number(one) for one in identification.holdout_rmse_V],
        "holdout_rmse_before_V": [_number(one) for one in identification.holdout_rmse_before_V],
        "improvement": _number(better.share),
        "min_improvement": MIN_IMPROVEMENT,
        "duration_s": _number(duration_s),
        "records": [
            {
                "name": one.name,
                "held_out": one.is_held_out,
                "duration_s": _number(float(one.time_s[-1] - one.time_s[0])),
                "rows": len(one.time_s),
            }
            for one in identification.predictions
        ],
        "notes": list(notes),
        "trouble": trouble,
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _number(value: float | Any) -> float | None:
    return float(f"{value:.{DIGITS}g}") if isfinite(value) else None
