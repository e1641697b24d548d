"""The section of a run's report on its rig file: which parameters have moved, and which the run does not determine."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace

from hil.core.identification.drift import ALL_CHECKED
from hil.core.identification.parameters import BY_NAME
from hil.edge.record.manifest import Manifest
from hil.edge.record.run_folder import RunFolder
from hil.review import page
from hil.review.kpi import Kpi
from hil.review.parameter_drift import file_words, has_moved, sentence


def with_recorded(kpi: Kpi, folder: RunFolder) -> Kpi:
    """The figures with the `parameters` of kpi.json, so that they are not computed again; as they are without."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        recorded = json.loads(folder.kpi_path.read_text(encoding="utf-8"))
        return replace(kpi, parameters=dict(recorded["parameters"]), parameters_note=str(recorded["parameters_note"]))
    return kpi


def drift_section(manifest: Manifest, kpi: Kpi) -> str:
    """A table of the determined parameters, a sentence for each that has moved, and the names of the others."""
    if not kpi.parameters:
        return f'<p class="soft">Not determined: {page.escape(kpi.parameters_note)}.</p>'
    rows = [
        [
            name,
            page.number(value["file"], 5),
            f"{page.number(value['estimate'], 5)} ± {page.number(value['sd'], 2)}",
            BY_NAME[name].unit,
            page.number(value["shift_sd"], 2),
            page.number(value["per_hour"], 2),
        ]
        for name, value in kpi.parameters.items()
    ]
    heads = ["parameter", "file", "this run", "unit", "moved [standard deviations]", "per hour"]
    moved = [sentence(name, value, file_words(manifest)) for name, value in kpi.parameters.items() if has_moved(value)]
    texts = [f"{text[0].upper()}{text[1:]}." for text in moved] or ["All that the run determines agrees with the file."]
    missing = [name for name in ALL_CHECKED if name not in kpi.parameters]
    if missing:
        texts.append(f"Not determined by the movement of this run: {', '.join(missing)}.")
    body = "".join(f"<p>{page.escape(text)}</p>" for text in texts)
    return body + page.table(heads, rows, numeric=frozenset((1, 2, 4, 5)))
