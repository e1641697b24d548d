from __future__ import annotations

import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from hil.core.types import Event, Severity
from hil.edge.record.manifest import Window
from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder
from hil.review import table3
from hil.review.alarm_table import last_estimate
from hil.review.kpi import compute
from hil.review.run_figures import thin
from hil.review.run_report import write_report
from hil.review.ticks import Ticks, read
from tests.review import toy


class Tags(HTMLParser):
    """Notes the tags and where they point to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.targets: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.targets += [value or "" for name, value in attrs if name in ("href", "src", "xlink:href", "action")]


@pytest.fixture(scope="module")
def page(whole_run: RunFolder, run_without_reconfiguration: RunFolder) -> str:
    return write_report(whole_run, run_without_reconfiguration).read_text(encoding="utf-8")


def test_report_stands_alone(page: str) -> None:
    tags = Tags(page)
    assert all(target.startswith("#") for target in tags.targets)
    assert not {"script", "link", "img", "iframe"} & set(tags.tags)
    assert "http" not in page
    assert not re.search(r"url\((?!#)", page)


def test_report_has_the_papers_figures_and_its_table(page: str) -> None:
    for number in (2, 3, 4, 5):
        assert f"<b>Figure {number}.</b>" in page
    assert Tags(page).tags.count("svg") == 6
    assert "Timing." not in page, "a simulated clock is never late"
    assert "no reconfiguration" in page
    for figure in ("13.07", "9.231", "0.702", "0.501", "9.348", "9.405", "6.189", "6.234"):
        assert f">{figure}<" in page


def test_report_shows_the_process_noise_that_was_learned(tmp_path: Path, page: str) -> None:
    assert "process noise learned" not in page, "nothing was learned"
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    recorder = Recorder.open(folder)
    recorder.tick(next(toy.steps())[0]._replace(level_walk_cm_sqrt_s=(6.3e-4, 0.01, 0.002, 0.018)))
    recorder.close("complete", "")
    text = write_report(folder).read_text(encoding="utf-8")
    assert "process noise learned, tanks 1 to 4" in text
    assert "0.00063, 0.01, 0.002, 0.018 cm/√s" in text


def test_report_counts_the_probes(tmp_path: Path, page: str) -> None:
    assert "probes" not in page, "none was made"
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    recorder = Recorder.open(folder)
    states = ("wait", "begin", "end")
    events = tuple(Event(Severity.INFO, "probe", f"probe: {state}", {"state": state}) for state in states)
    recorder.tick(next(toy.steps())[0]._replace(events=events, probe_V=(0.3, -0.3)))
    recorder.close("complete", "")
    text = write_report(folder).read_text(encoding="utf-8")
    assert "<b>1</b><span>probes: movements of the pumps that tell faults apart</span>" in text
    assert "probe: begin" in text
    ticks, _ = read(folder)
    assert (ticks["probe1_V"][0], ticks["probe2_V"][0]) == (0.3, -0.3)


def test_report_escapes_what_comes_from_outside(tmp_path: Path, page: str) -> None:
    assert "control on &lt;now&gt; &amp; steady" in page
    assert "gain_V_cm = 0.5 # &lt;b&gt;&amp;" in page
    evil = "<script>alert('x')</script>"
    plan = replace(
        toy.plan(), scenario=evil, windows=(Window(evil, 0.0, 1.0),), copies={evil: evil}, settings=toy.plan().settings
    )
    folder = RunFolder.create(tmp_path / "run", plan)
    recorder = Recorder.open(folder)
    data = {"detected_s": 0.0, "kind": evil, "target": evil, "size": evil, "cause": evil}
    events = tuple(Event(Severity.ERROR, code, evil, data) for code in ("alarm", "trip", evil))
    recorder.tick(next(toy.steps())[0]._replace(events=events))
    recorder.close("failed", evil)
    text = write_report(folder).read_text(encoding="utf-8")
    assert "script" not in Tags(text).tags
    assert "&lt;script&gt;" in text


def test_times_of_an_alarm_have_hundredths_of_a_second(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    recorder = Recorder.open(folder)
    data = {"kind": "leak", "target": 1, "size": 0.2, "detected_s": 234.56, "onset_s": 223.45, "isolated_s": 245.67}
    event = Event(Severity.ERROR, "alarm", "leak", data)
    recorder.tick(next(toy.steps())[0]._replace(events=(event,)))
    recorder.close("complete", "duration over")
    text = write_report(folder).read_text(encoding="utf-8")
    assert all(f">{value}<" in text for value in ("234.56", "223.45", "245.67"))


def test_same_record_gives_the_same_report(
    page: str, whole_run: RunFolder, run_without_reconfiguration: RunFolder
) -> None:
    assert write_report(whole_run, run_without_reconfiguration).read_text(encoding="utf-8") == page


def test_report_of_an_interrupted_run_says_so(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    recorder = Recorder.open(folder)
    for record, _ in toy.steps(until_s=30.0):
        recorder.tick(record)
    recorder.flush()
    text = write_report(folder).read_text(encoding="utf-8")
    recorder.close("stopped", "")
    assert "interrupted" in text
    assert "0.0 s of it recorded" in text
    assert ">13.07<" not in text, "half a window is not set beside the paper's"


def test_report_of_a_live_run_shows_its_timing(tmp_path: Path) -> None:
    folder = toy.record_run(tmp_path / "run", live=True, until_s=80.0)
    text = write_report(folder).read_text(encoding="utf-8")
    assert "<b>Timing.</b>" in text
    assert "estimated levels" in text


def test_report_of_a_run_without_steps(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    Recorder.open(folder).close("failed", "the rig did not become ready")
    assert "No control step was recorded" in write_report(folder).read_text(encoding="utf-8")


def test_thinning_keeps_the_peaks_and_the_ends() -> None:
    times_s = np.arange(50_000, dtype=np.float64) * 0.01
    values: npt.NDArray[np.float64] = np.sin(times_s)
    values[31_234] = 9.0
    thin_s, thinned = thin(times_s, values)
    assert len(thin_s) <= 1510
    assert thinned.max() == 9.0
    assert (thin_s[0], thin_s[-1]) == (times_s[0], times_s[-1])
    assert (np.diff(thin_s) > 0).all()


def test_table_3_has_paper_and_run_side_by_side(whole_run: RunFolder, run_without_reconfiguration: RunFolder) -> None:
    both = table3.lines(compute(whole_run), compute(run_without_reconfiguration))
    assert [line.paper_Vs for line in both] == [(13.07, 9.231), (0.702, 0.501), (9.348, 9.405), (6.189, 6.234)]
    assert [[ours is None for ours in line.ours_Vs] for line in both] == [[True, False], [False, True]] * 2
    assert [line.ours_Vs == (None,) for line in table3.lines(compute(whole_run))] == [True, False, True, False]


def heads(text: str, section: str) -> list[str]:
    """The column heads of the table in a section of the report."""
    (head,) = re.findall(rf"<h2>{section}</h2>.*?<thead>(.*?)</thead>", text, re.DOTALL)
    return re.findall(r"<th[^>]*>(.*?)</th>", head)


def test_the_papers_table_names_its_runs(
    page: str, whole_run: RunFolder, run_without_reconfiguration: RunFolder
) -> None:
    """It used to say "here" for both runs, and to show only one of two with the same strategy."""
    names = [whole_run.path.name, run_without_reconfiguration.path.name]
    ours = [head for name in names for head in (name, "off by")]
    expected = ["window", "strategy", "output", "paper", *ours]
    assert heads(page, "Table 3 of the paper") == expected
    assert "compared with" in page.partition("</header>")[0]
    assert names[1] in page.partition("</header>")[0]


def test_two_runs_of_one_strategy_and_one_name_are_both_in_the_table(whole_run: RunFolder, tmp_path: Path) -> None:
    other = RunFolder(shutil.copytree(whole_run.path, tmp_path / whole_run.path.name))
    text = write_report(other, whole_run).read_text(encoding="utf-8")
    assert heads(text, "Table 3 of the paper")[4:8] == [str(other.path), "off by", str(whole_run.path), "off by"]
    both = table3.lines(compute(other), compute(whole_run))
    assert both[1].ours_Vs[0] == both[1].ours_Vs[1] is not None
    assert heads(text, "Alarms and trips")[:2] == ["run", "time [s]"]


def test_the_alarm_table_has_the_last_estimate_of_a_pumps_effectiveness(whole_run: RunFolder) -> None:
    """Its only size was the one at the isolation, which the detector corrects for some seconds more."""
    ticks, _ = read(whole_run)
    times_s = ticks["t_s"]
    theta1 = np.select([times_s < 201.0, times_s < 300.0, times_s < 400.0], [1.0, 0.37, 0.41], 0.8)
    changed = Ticks({**ticks.columns, "theta1": theta1})
    alarms = compute(whole_run).alarms
    assert (alarms[0]["kind"], alarms[0]["target"], alarms[0]["isolated_s"]) == ("pump_effectiveness", 1, 201.0)
    assert last_estimate(alarms, 0, changed) == 0.8, "at the end of the run"
    assert last_estimate([{**alarms[0], "recovered_s": 400.0}], 0, changed) == 0.41, "before the recovery"
    assert last_estimate([alarms[0], {**alarms[0], "detected_s": 300.0}], 0, changed) == 0.37, "before the next alarm"
    assert last_estimate([{**alarms[0], "kind": "leak"}], 0, changed) is None
    assert last_estimate([{**alarms[0], "isolated_s": None}], 0, changed) is None
    text = write_report(whole_run).read_text(encoding="utf-8")
    assert heads(text, "Alarms and trips")[2:4] == ["size", "last estimate"]
    assert "the last estimate is that at the end of the run" in text
