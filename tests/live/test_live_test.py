"""`hil test` on a bus: scenarios one after the other, and the ways in which a test ends early at 0 V."""

import signal
from pathlib import Path

import pytest

from tests.live.live_bench import emulator, hil, start
from tests.review.junit_file import checked
from tests.waiting import wait_for

pytestmark = pytest.mark.live
GOOD = '[[accept]]\nname = "no trip"\nno_trip = true\n'
TRIP = '[[fault]]\nat_s = 0.5\nkind = "node_reboot"\ntarget = "pump"\n'


def scenario(folder: Path, name: str, duration_s: float, more: str = GOOD) -> Path:
    folder.mkdir(exist_ok=True)
    file = folder / f"{name}.toml"
    file.write_text(f'[scenario]\nname = "{name}"\nduration_s = {duration_s}\n{more}')
    return file


def results(junit: Path) -> dict[str | None, str]:
    found = {}
    for suite in checked(junit.read_bytes()):
        tags = [one.tag for one in suite.iterfind("testcase/*")]
        found[suite.get("name")] = ", ".join(tags) or "passed"
    return found


def arguments(tmp_path: Path, channel: str) -> list[Path | str]:
    files: list[Path | str] = ["--junit", tmp_path / "out.xml", "--out", tmp_path / "runs"]
    return ["test", tmp_path / "mine", "-i", "slcan", "-c", channel, *files]


def test_scenarios_run_one_after_the_other_on_a_bus(tmp_path: Path) -> None:
    scenario(tmp_path / "mine", "a", 1.0)
    scenario(tmp_path / "mine", "b", 1.0, GOOD + '[[accept]]\nname = "dry tanks"\nlevel_max_cm = 0.1\n')
    scenario(tmp_path / "mine", "c", 1.0)
    with emulator(tmp_path / "node.jsonl") as rig:
        done = hil(*arguments(tmp_path, rig.channel))
        assert done.returncode == 6, (done.stdout, done.stderr)
        assert results(tmp_path / "out.xml") == {"a": "passed", "b": "failure", "c": "passed"}
        last = rig.pump()[-1]
    assert (last["state"], last["applied_V"]) == ("ready", [0.0, 0.0])


def test_a_stop_signal_ends_the_whole_test_at_zero_volts(tmp_path: Path) -> None:
    scenario(tmp_path / "mine", "a", 0.5)
    scenario(tmp_path / "mine", "b", 60.0)
    scenario(tmp_path / "mine", "c", 60.0)
    with emulator(tmp_path / "node.jsonl") as rig:
        process = start(["hil", *arguments(tmp_path, rig.channel)])
        wait_for(lambda: (tmp_path / "runs" / "b" / "run.json").exists(), timeout_s=40.0)
        before = len(rig.commanded())
        wait_for(lambda: len(rig.commanded()) > before + 3, timeout_s=40.0)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=40.0)
        assert process.returncode == 143, (out, err)
        last = rig.pump()[-1]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", [0.0, 0.0], "disabled")
    assert results(tmp_path / "out.xml") == {"a": "passed", "b": "error", "c": "skipped"}
    assert "SIGTERM" in out
    assert not (tmp_path / "runs" / "c").exists()


def test_a_trip_that_no_limit_expects_ends_the_test(tmp_path: Path) -> None:
    """The emulator plays the fault; the next scenario would have moved the pumps again."""
    first = scenario(tmp_path / "mine", "a", 3.0, TRIP + GOOD)
    scenario(tmp_path / "mine", "b", 1.0)
    with emulator(tmp_path / "node.jsonl", scenario=first) as rig:
        done = hil(*arguments(tmp_path, rig.channel), "--html", tmp_path / "out.html")
        assert done.returncode == 3, (done.stdout, done.stderr)
        assert rig.pump()[-1]["applied_V"] == [0.0, 0.0]
    assert results(tmp_path / "out.xml") == {"a": "error, failure", "b": "skipped"}
    page = (tmp_path / "out.html").read_text()
    assert 'href="runs/a/report.html"' in page
    assert "b: a ended as tripped: " in page


def test_a_bus_that_is_not_there_is_refused_as_by_hil_run(tmp_path: Path) -> None:
    scenario(tmp_path / "mine", "a", 1.0)
    done = hil(*arguments(tmp_path, "/dev/ttyNONE0"))
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert "ttyNONE0" in done.stderr
    assert results(tmp_path / "out.xml") == {"a": "skipped"}
