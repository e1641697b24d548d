"""What an identification leaves in its folder, and when it replaces the old rig file."""

from __future__ import annotations

import io
import json
import math
import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hil.bench.identification_result import NotReplacedError, replace_rig, write_result
from hil.cli.identify_result import finish
from hil.cli.view_command import open_view
from hil.core.identification.improvement import improvement, misfit_sentence, row_noise_V
from hil.core.identification.result import Identification
from hil.edge.config.rig_file import load_rig
from hil.edge.record.record_errors import IncompleteRecordError
from hil.review.identification_json import as_json
from hil.review.identification_recording import all_curves
from hil.review.identification_report import ReportFacts, render
from hil.review.viewer import NoViewerError
from tests.cli.failing_disk import FailingDisk
from tests.identification.result_bench import identification, undetermined, with_value, without_records

CONFIG = Path(__file__).resolve().parents[2] / "config"
NOW = datetime(2026, 11, 26, 7, 30)


@pytest.fixture
def rig_path(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_bytes((CONFIG / "rig.toml").read_bytes())
    return path


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def _report(found: Identification) -> str:
    return render(found, ReportFacts("rig.toml", 240.0, (3.0, 3.0)))


def test_the_folder_has_rig_file_json_report_and_recording_and_view_opens_it(rig_path: Path, out: Path) -> None:
    before = rig_path.read_bytes()
    result = write_result(identification(), rig_path, out)
    assert sorted(path.name for path in out.iterdir()) == [
        "identification.json", "identification.rrd", "identified.toml", "report.html",
    ]  # fmt: skip
    assert rig_path.read_bytes() == before, "the old file is left alone"
    assert load_rig(out / "identified.toml").pumps.gain_cm3_Vs == (3.057, 3.41)
    assert "-gain_cm3_Vs = [3.33, 3.35]" in result.diff
    assert (out / "identification.rrd").read_bytes()[:4] == b"RRF2"
    report = (out / "report.html").read_text()
    assert "+gain_cm3_Vs = [3.057, 3.41]" in report
    assert report.count("<svg") == 7, "two of intervals, held-out record, correlation, three of all records"
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("DISPLAY", raising=False)
        patch.delenv("WAYLAND_DISPLAY", raising=False)
        with pytest.raises(NoViewerError, match=re.escape(f"the report is at {out / 'report.html'}")):
            open_view(out, None, is_page=False)


def test_json_has_every_parameter_with_its_interval() -> None:
    content = json.loads(as_json(identification(), 240.0))
    assert content["format"] == 1
    assert content["parameters"]["k1"] == {
        "value": 3.057, "low": 3.056412, "high": 3.057588, "unit": "cm3/Vs", "was": 3.33, "status": "identified",
    }  # fmt: skip
    assert content["parameters"]["curve1"]["status"] == "fixed"
    assert len(content["parameters"]) == len(identification().parameters)
    assert content["structure"] == ["dead_zone"]
    assert content["duration_s"] == 240.0
    assert content["null_directions"] == []
    assert [round(rmse_V, 3) for rmse_V in content["holdout_rmse_V"]] == [0.005] * 4
    assert content["holdout_rmse_before_V"][0] > 1.0
    assert [(one["name"], one["held_out"]) for one in content["records"]] == [("basic", False), ("check", True)]


def test_json_has_no_number_that_json_lacks() -> None:
    """Intervals without end, and errors of sensors that a record lacks, once gave Infinity and NaN."""
    found = replace(undetermined(), holdout_rmse_V=(math.nan, 0.005, 0.005, 0.005))
    text = as_json(found, 240.0)
    content = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert content["parameters"]["k1"]["high"] is None
    assert content["parameters"]["k1"]["status"] == "not identifiable"
    assert content["holdout_rmse_V"][0] is None
    assert content["null_directions"][0]["names"] == ["k1", "k2", "sensor_gain1", "sensor_gain2"]


def test_the_report_has_a_sentence_for_each_parameter() -> None:
    text = _report(without_records())
    for words in (
        "Pump 1 gives 8.2 % less for 1 V than the file said; known to 0.019 %.",
        "With its dead zone and its curve it gives 17.7 % less at 3 V.",
        "Pump 2 gives 1.79 % more for 1 V",
        "of the flow of pump 1 goes to tank 1, the rest to tank 4; the file said 70 %",
        "of the flow of pump 2 goes to tank 2, the rest to tank 3; the file said 60 %",
        "The outlet of tank 4 is 1.58 % smaller than the file said",
        "Pump 1 follows its voltage with a time constant of 0.3100 ± 0.0098 s; the file said 0.2 s.",
        "Pump 1 gives no flow below 0.3100 ± 0.0039 V",
        "Rise of the reading of tank 3 for 1 cm: 0.5 V/cm, as in the file; not estimated.",
    ):
        assert words in text.replace("&#x27;", "'"), words
    fixed = sum(one.status == "fixed" for one in identification().parameters)
    assert text.count("not estimated.") == fixed
    assert text.count("<li>") == len(identification().parameters) - fixed


@pytest.mark.parametrize("name", ["curve1", "delay2", "datum3", "sensor_gain4", "sensor_offset1", "overflow4"])
def test_every_kind_of_parameter_has_its_sentence(name: str) -> None:
    was = identification()[name].was
    found = with_value(
        without_records(), name, value=was + 0.01, low=was + 0.009, high=was + 0.011, status="identified"
    )
    text = _report(found)
    assert text.count("<li>") == 13
    assert f">{name}</td>" in text


def test_the_report_says_in_words_what_the_records_do_not_tell() -> None:
    text = _report(replace(undetermined(), predictions=(), predictions_before=()))
    assert "read the level of tank 1 by a ruler" in text
    assert "not all identifiable" in text
    assert text.count("the records do not determine it on its own") == 4
    assert "for 1 V: the records do not determine it on its own. The file has a value of 3.057 cm3/Vs" in text
    assert "It stays 0.5 V/cm, as in the file." in text


def test_hostile_names_of_rig_file_and_records(tmp_path: Path) -> None:
    """A pair of $ in the name of a record is a formula for matplotlib, and a name that is no UTF-8 can't be encoded."""
    rig_path, out = tmp_path / "<script>alert('rig')\x01$x$.toml", tmp_path / "o $u$ [t]"
    rig_path.write_bytes((CONFIG / "rig.toml").read_bytes())
    out.mkdir()
    found = identification()
    named = tuple(replace(one, name="run $x$ \\frac{ <b>&\n\udc80") for one in found.predictions[:1])
    result = write_result(replace(found, predictions=named, predictions_before=()), rig_path, out)
    text = result.report.read_text(encoding="utf-8")
    assert "<script" not in text
    assert "<b>&" not in text
    assert "http://" not in text
    assert "https://" not in text
    assert json.loads(result.json.read_text())["records"][0]["name"] == named[0].name
    assert (out / "identification.rrd").is_file()
    assert replace_rig(result, rig_path, NOW).read_bytes() == (CONFIG / "rig.toml").read_bytes()


def test_a_refusal_leaves_the_reason_and_no_rig_file(rig_path: Path, out: Path) -> None:
    """The rig file of an earlier identification into the same folder once stayed there, beside the refusal."""
    write_result(without_records(), rig_path, out)
    found = identification(refusal="pump 2 was never moved", predictions=(), parameters=(), predictions_before=())
    result = write_result(found, rig_path, out)
    assert sorted(path.name for path in out.iterdir()) == ["identification.json", "report.html"]
    report = (out / "report.html").read_text()
    assert "pump 2 was never moved" in report
    assert "No rig file was written; rig.toml stays as it is." in report
    assert "held-out error" not in report
    assert json.loads((out / "identification.json").read_text())["refusal"] == "pump 2 was never moved"
    with pytest.raises(NotReplacedError, match="pump 2 was never moved"):
        replace_rig(result, rig_path, NOW)


def test_the_old_file_is_replaced_and_kept(rig_path: Path, out: Path) -> None:
    before = rig_path.read_bytes()
    result = write_result(without_records(), rig_path, out)
    copy = replace_rig(result, rig_path, NOW)
    assert copy.name == "rig-2026-11-26T07-30.toml"
    assert copy.read_bytes() == before
    assert rig_path.read_bytes() == (out / "identified.toml").read_bytes()


@pytest.mark.parametrize(("after_V", "is_replaced"), [(0.0101, False), (0.00899, True), (0.05, False)])
def test_only_a_file_that_predicts_better_by_10_percent_replaces_the_old_one(
    rig_path: Path, out: Path, after_V: float, is_replaced: bool
) -> None:
    before = rig_path.read_bytes()
    found = without_records(holdout_rmse_before_V=(0.01,) * 4, holdout_rmse_V=(after_V,) * 4)
    result = write_result(found, rig_path, out)
    if is_replaced:
        replace_rig(result, rig_path, NOW)
        assert rig_path.read_bytes() != before
        return
    with pytest.raises(NotReplacedError, match=r"better by 10% or more.*the old one by 10 mV"):
        replace_rig(result, rig_path, NOW)
    assert rig_path.read_bytes() == before
    assert sorted(path.name for path in rig_path.parent.iterdir()) == ["out", "rig.toml"]


def test_without_a_held_out_record_nothing_is_replaced(rig_path: Path, out: Path) -> None:
    nothing = (math.nan,) * 4
    found = without_records(holdout_rmse_before_V=nothing, holdout_rmse_V=nothing)
    with pytest.raises(NotReplacedError, match="No held-out record tells"):
        replace_rig(write_result(found, rig_path, out), rig_path, NOW)


def test_sensors_that_the_held_out_record_lacks_do_not_count() -> None:
    nan = math.nan
    better = improvement(
        identification(holdout_rmse_before_V=(0.02, nan, 0.02, 1.0), holdout_rmse_V=(0.01, 1.0, 0.01, nan))
    )
    assert better.share == pytest.approx(0.5)


def test_the_noise_of_a_row_is_that_of_its_readings_mean_and_leaves_slow_errors_out() -> None:
    """A band of 95 % of a single reading's noise once was drawn about means of five."""
    one = identification().predictions[0]
    slow = replace(one, predicted_V=one.predicted_V + 0.05 * np.sin(0.1 * one.time_s)[:, None])
    assert row_noise_V([one], 0) == pytest.approx(0.005, rel=0.05)
    assert row_noise_V([slow], 0) == pytest.approx(0.005, rel=0.05)
    still = replace(one, reading_V=np.where(one.time_s[:, None] < 60.0, one.predicted_V, one.reading_V))
    assert row_noise_V([still], 0) == pytest.approx(0.005, rel=0.1), "rows at the end of the range do not count"
    assert math.isnan(row_noise_V([], 0))


def test_an_interval_that_ends_at_a_limit_is_given_by_its_longer_half() -> None:
    found = with_value(without_records(), "delay1", value=0.0, low=0.0, high=0.0051, status="identified")
    assert "The flow of pump 1 arrives after 0.0000 ± 0.0051 s; the file said 0 s." in _report(found)


def test_a_model_that_misses_the_held_out_record_is_said_to_lack_something() -> None:
    found = without_records(holdout_rmse_V=(0.005, 0.034, 0.006, math.nan))
    assert "misses sensor 2 in the held-out record by 6.8 times its noise" in misfit_sentence(found)
    assert "misses sensor 2" in _report(found)
    assert misfit_sentence(without_records()) == ""


def test_a_full_disk_leaves_the_old_rig_file_and_names_the_file(
    rig_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = rig_path.read_bytes()
    for fails_from in range(1, 10, 3):
        disk = FailingDisk(out, fails_from)
        with monkeypatch.context() as patch:
            disk.install(patch)
            with pytest.raises(IncompleteRecordError, match=r"(identified.toml|identification.json|report.html) can't"):
                write_result(without_records(), rig_path, out)
    assert rig_path.read_bytes() == before
    assert not [path for path in out.iterdir() if path.name.startswith(".")], "nothing half-written is left"


def test_the_recording_has_measured_predicted_and_residual_of_each_tank() -> None:
    found = {curves.entity: curves for curves in all_curves(identification())}
    assert found["record1/readings/tank1"].names == ("measured", "predicted")
    assert found["record2/readings/tank4"].names == ("measured", "predicted by the old file", "predicted")
    assert found["record2/residuals/tank2"].values.std() == pytest.approx(5.0, rel=0.1)
    assert {"record1/levels", "record1/voltages"} <= set(found)


def _finish(found: Identification, rig_path: Path, out: Path, write: bool = False) -> tuple[int, str]:
    console = Console(file=io.StringIO(), width=60)
    code = finish(console, found, rig_path, out, write=write, now=NOW, rerun=False)
    assert isinstance(console.file, io.StringIO)
    return code, console.file.getvalue()


def test_the_command_shows_values_difference_and_what_is_not_determined(rig_path: Path, out: Path) -> None:
    code, shown = _finish(replace(undetermined(), predictions=(), predictions_before=()), rig_path, out)
    assert code == 0
    for words in (
        "gamma1",
        "0.710000",
        "-valve_split = [0.70, 0.60]",
        "+valve_split = [0.71, 0.592]",
        "--write replaces it",
    ):
        assert words in shown, words
    assert "not determined: k1, k2 and the gains of all sensors can only be known together" in shown
    assert max(map(len, shown.split("structure")[0].splitlines())) <= 60


def test_the_command_replaces_the_file_only_when_asked(rig_path: Path, out: Path) -> None:
    before = rig_path.read_bytes()
    assert _finish(without_records(), rig_path, out)[0] == 0
    assert rig_path.read_bytes() == before
    code, shown = _finish(without_records(), rig_path, out, write=True)
    assert code == 0
    assert f"the old file is kept as {rig_path.with_name('rig-2026-11-26T07-30.toml')}" in shown
    assert rig_path.read_bytes() != before


def test_the_command_says_why_it_does_not_replace_the_file(
    rig_path: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = without_records(holdout_rmse_before_V=(0.005,) * 4)
    assert _finish(found, rig_path, out, write=True)[0] == 4
    assert "predicts the held-out record better by 10% or more" in capsys.readouterr().err


def test_the_command_says_why_nothing_was_identified(
    rig_path: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = without_records(refusal="pump 2 was never moved", parameters=())
    assert _finish(found, rig_path, out, write=True)[0] == 4
    assert "nothing was identified: pump 2 was never moved" in capsys.readouterr().err
