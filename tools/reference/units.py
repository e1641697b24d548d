"""Unit of a settings key, from the end of its name."""

from __future__ import annotations

ENDINGS = (  # the longest first
    ("_cm3_sqrt_s", "cm³/√s"),
    ("_1_V", "1/V"),
    ("_cm3_Vs", "cm³/(V s)"),
    ("_cm_s2", "cm/s²"),
    ("_V_cm", "V/cm"),
    ("_V_s", "V/s"),
    ("_per_h", "1/h"),
    ("_cm2", "cm²"),
    ("_cm", "cm"),
    ("_V", "V"),
    ("_s", "s"),
)

BY_NAME = {
    "valve_split": "share",
    "pump_gain": "share",
    "outlet": "share",
    "lag": "share",
    "parameter_spread": "share",
    "lag_spread": "share",
    "scale_error": "share",
    "overflow_to_lower": "share",
    "split_scatter": "share",
    "duty": "share",
    "gain_ratio": "ratio",
    "lag_ratio": "ratio",
    "outlet_ratio": "ratio",
    "dead_below": "share",
    "output_poles": "1/s",
    "noise_gain_max": "V/V",
    "errors_per_s_max": "frames/s",
    "invalid_run_max": "readings",
    "refused_run_max": "frames",
    "bitrate": "bit/s",
    "dac_bits": "bit",
    "adc_bits": "bit",
}


def unit_of(name: str) -> str:
    """Unit of the key `name`; "–" for one without."""
    if name in BY_NAME:
        return BY_NAME[name]
    bare = name.removesuffix("_max")
    return next((unit for ending, unit in ENDINGS if bare.endswith(ending)), "–")
