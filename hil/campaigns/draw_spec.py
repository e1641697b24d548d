"""The campaign file's [draw] table: each seed draws a rig of its own. See docs/how-to/campaign.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self

from pydantic import Field, model_validator

from hil.edge.config.settings_file import LevelCm, Positive, Section, Volts

Ratio = Annotated[float, Field(gt=0.0, le=100.0, allow_inf_nan=False)]
Curve = Annotated[float, Field(ge=-0.05, le=1.0, allow_inf_nan=False)]
DeadZone = Annotated[float, Field(ge=0.0, le=9.0, allow_inf_nan=False)]
ScaleError = Annotated[float, Field(ge=-0.5, le=0.5, allow_inf_nan=False)]
Period = Annotated[float, Field(ge=0.001, le=0.2, allow_inf_nan=False)]

RATIOS = ("gain_ratio", "outlet_ratio", "lag_ratio")
"""Drawn uniformly in the logarithm, so that half and twice are equally likely; all other ranges uniformly."""


class DrawnReferences(Section):
    """Random steps of the references of both outputs.

    every_s : the time from one step to the next. levels_cm : of tanks 1 and 2; only levels that the rig can hold.
    """

    every_s: tuple[Positive, Positive]
    levels_cm: tuple[LevelCm, LevelCm]

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Self:
        check_ordered({"every_s": self.every_s, "levels_cm": self.levels_cm})
        return self


class Draw(Section):
    """What each seed draws of the emulated rig: ranges for each part of its own, and lists of choices.

    A ratio is relative to the rig that the campaign starts from. rig_knows : whether rig.toml of the case has the drawn
    values, too; the control period is always known. start_V : 0, 0 begins with empty tanks; other voltages are those
    of the undrawn rig, and the drawn one starts where its pumps give the same flow.
    """

    rig_knows: bool = False
    gain_ratio: tuple[Ratio, Ratio] | None = None
    curve_1_V: tuple[Curve, Curve] | None = None
    dead_zone_V: tuple[DeadZone, DeadZone] | None = None
    lag_ratio: tuple[Ratio, Ratio] | None = None
    outlet_ratio: tuple[Ratio, Ratio] | None = None
    scale_error: tuple[ScaleError, ScaleError] | None = None
    period_s: tuple[Period, ...] = ()
    start_V: tuple[tuple[Volts, Volts], ...] = ()
    references: DrawnReferences | None = None

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Self:
        names = (*RATIOS, "curve_1_V", "dead_zone_V", "scale_error")
        check_ordered({name: span for name in names if (span := getattr(self, name)) is not None})
        return self


def check_ordered(spans: Mapping[str, tuple[float, float]]) -> None:
    """Refuse a range whose first number is above the second. Raises ValueError."""
    for name, (low, high) in spans.items():
        if low > high:
            raise ValueError(f"{name} {[low, high]}: the first is above the second")
