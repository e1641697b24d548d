"""The page on diagnosis names constants and modules of the detector; they are there, with these values."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from hil.core.diagnosis.glr.tuning import Tuning

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/explanation/diagnosis.md").read_text(encoding="utf-8")


def test_the_tuning_table_has_the_detector_s_constants_and_values() -> None:
    defaults = dataclasses.asdict(Tuning())
    section = PAGE.partition("## Tuning")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]+) \| ([^|]+) \|", section, re.MULTILINE)
    assert len(rows) > 10
    for names, values in rows:
        keys = re.findall(r"`(\w+)`", names)
        assert set(keys) <= set(defaults), keys
        for key, shown in zip(keys, values.split(", "), strict=True):
            number = float(re.findall(r"[\d.e-]+", shown)[0])
            scale = 0.01 if "%" in shown else 1e-3 if "mV" in shown else 1.0
            assert abs(number * scale - float(defaults[key])) < 1e-9, key


def test_modules_that_the_page_names_exist() -> None:
    modules = set(re.findall(r"`(\w+\.py)`", PAGE))
    assert modules
    for module in modules:
        assert (ROOT / "hil/core/diagnosis/glr" / module).is_file(), module
