"""The co-simulation unit as a file and as an interface: a checker, saved states, wrong calls, no compiler."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from firmware_sim import cli
from firmware_sim.fmu.archive import archive, sources
from firmware_sim.fmu.c_from_python import c_code
from firmware_sim.fmu.compiler import CompilerError
from firmware_sim.fmu.export import export, left_out
from tests.firmware_sim.fault_bench import fault
from tests.firmware_sim.fmu_bench import (
    NAMES,
    UnitFile,
    run_unit,
)
from tests.firmware_sim.sim_bench import SECOND, emulator, shipped


def test_every_variable_says_what_it_is(unit: UnitFile) -> None:
    for one in unit.description.modelVariables:
        assert one.unit, one.name
        assert one.description, one.name
        assert (one.causality == "output") == (one.start is None)
        if one.start is not None:
            assert float(one.min) <= float(one.start) <= float(one.max), one.name


def test_an_fmi_checker_finds_nothing_wrong(unit: UnitFile) -> None:
    assert validate_fmu(str(unit.file)) == []


def test_a_saved_state_is_the_whole_state(unit: UnitFile) -> None:
    """With water on its way in a hose, and a pump that has changed in between."""
    with unit.instance() as instance:
        instance.start(delay1_s=1.0, v1_applied_V=8.0)
        instance.step(0, SECOND // 2)
        state = instance.slave.getFMUstate()
        ends = []
        for _ in range(2):
            instance.step(SECOND // 2, 2 * SECOND)
            ends.append(instance.get(*NAMES))
            instance.set(v1_applied_V=1.0)
            instance.step(2 * SECOND, 3 * SECOND)
            instance.slave.setFMUstate(state)
        instance.slave.freeFMUstate(state)
    assert ends[0] == ends[1]


def test_a_reset_unit_is_as_new(unit: UnitFile) -> None:
    with unit.instance() as instance:
        fresh = instance.get(*(one.name for one in unit.description.modelVariables))
        instance.start(v1_applied_V=9.0, leak1=3.0, height3_cm=5.0, delay2_s=2.0)
        instance.step(0, 5 * SECOND)
        instance.slave.reset()
        assert instance.get(*(one.name for one in unit.description.modelVariables)) == fresh
        instance.slave.setupExperiment(startTime=0.0)
        instance.start().step(0, SECOND)


def test_two_instances_know_nothing_of_each_other(unit: UnitFile) -> None:
    with unit.instance() as first, unit.instance() as second:
        first.start(v1_applied_V=10.0)
        second.start()
        alone = []
        for number in range(10):
            first.step(number * SECOND, (number + 1) * SECOND)
            second.step(number * SECOND, (number + 1) * SECOND)
        alone = second.get(*NAMES)
    with unit.instance() as third:
        third.start()
        run_unit(third, [], [number * SECOND for number in range(1, 11)], ())
        assert third.get(*NAMES) == alone


def test_a_value_that_is_out_of_range_by_rounding_is_taken(unit: UnitFile) -> None:
    with unit.instance() as instance:
        instance.start(effectiveness1=1.0 + 1e-15, leak1=-1e-17)
        assert instance.get("effectiveness1", "leak1") == [1.0, 0.0]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("v1_applied_V", 10.1, "v1_applied_V = 10.1 is outside 0 .. 10 V"),
        ("v2_applied_V", math.nan, "v2_applied_V = nan is outside"),
        ("leak3", -0.1, "leak3 = -0.1 is outside 0 .. 10"),
        ("bias1_V", math.inf, "bias1_V = inf is outside"),
        ("area1_cm2", 30.0, "area1_cm2 is a parameter"),
        ("h1_V", 1.0, "h1_V is an output"),
    ],
)
def test_a_wrong_value_is_refused_and_nothing_changes(unit: UnitFile, name: str, value: float, message: str) -> None:
    with unit.instance() as instance:
        instance.start()
        before = instance.get(*(one.name for one in unit.description.modelVariables))
        with pytest.raises(FMICallException):
            instance.set(effectiveness1=0.5, **{name: value})
        assert len(instance.messages) == 1
        assert instance.messages[0].startswith(message)
        assert instance.get(*(one.name for one in unit.description.modelVariables)) == before


@pytest.mark.parametrize(("now_s", "step_s"), [(0.0, -0.1), (0.0, math.nan), (math.nan, 0.1), (1.0, 0.1), (0.0, 1e300)])
def test_a_wrong_step_is_refused(unit: UnitFile, now_s: float, step_s: float) -> None:
    with unit.instance() as instance:
        instance.start()
        with pytest.raises(FMICallException):
            instance.slave.doStep(currentCommunicationPoint=now_s, communicationStepSize=step_s)
        assert instance.messages[0].startswith("fmi2DoStep:")
        instance.step(0, SECOND)


def test_calls_in_the_wrong_order_are_refused(unit: UnitFile) -> None:
    with unit.instance() as instance:
        for call in (lambda: instance.step(0, SECOND), instance.slave.terminate, instance.slave.exitInitializationMode):
            with pytest.raises(FMICallException):
                call()
        with pytest.raises(FMICallException):
            instance.start(start1_cm=30.0)
        assert instance.messages[-1] == "start1_cm = 30 is above height1_cm = 20"
        with pytest.raises(FMICallException):
            instance.slave.getReal([len(unit.description.modelVariables)])


def test_a_unit_of_another_rig_has_another_guid() -> None:
    changed = emulator(tanks={"area_cm2": [28.0, 32.0, 28.0, 32.000001]})
    texts = [sources(settings)["modelDescription.xml"] for settings in (shipped(), shipped(), changed)]
    guids = [text.partition('guid="')[2].partition('"')[0] for text in texts]
    assert guids[0] == guids[1] != guids[2]
    assert len(guids[0]) == len("{00000000-0000-0000-0000-000000000000}")


def test_the_archive_is_the_same_whenever_it_is_made(unit: UnitFile, tmp_path: Path) -> None:
    file = tmp_path / "again.fmu"
    said = export(file, shipped(), (), seed=1)
    assert file.read_bytes() == unit.file.read_bytes()
    assert said.startswith(f"firmware-sim wrote {file}: FMI 2.0 co-simulation")
    assert [one.name for one in tmp_path.iterdir()] == ["again.fmu"]


def test_what_the_unit_leaves_out_is_said() -> None:
    faults = (fault("leak", 1, 0.5), fault("pump_dead", 1))
    rough = emulator(tanks={"turbulence_cm3_sqrt_s": 0.1}, pumps={"split_scatter": 0.05}, sensors={"wave_V": 0.01})
    assert left_out(rough, faults) == [
        "sensor noise", "waves", "turbulence", "play of the valves (split_scatter)", "converters (dac_bits, adc_bits)",
        "the scenario's 2 faults (they are inputs)",
    ]  # fmt: skip
    quiet = emulator(sensors={"noise_V": 0.0, "adc_bits": 0}, pumps={"dac_bits": 0})
    assert left_out(quiet, ()) == []


def test_without_a_compiler_there_is_one_clear_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CompilerError, match="no C compiler: install cc, gcc or clang, or name one in CC"):
        export(tmp_path / "rig.fmu", shipped(), (), seed=0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("compiler", "message"),
    [("no-such-cc", "is no program"), ("'gcc", "is no program"), ("false", "failed with code 1")],
)
def test_a_compiler_that_fails_is_named(monkeypatch: pytest.MonkeyPatch, compiler: str, message: str) -> None:
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(CompilerError, match=message):
        archive(shipped())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--fmu", "rig.zip"], "--fmu rig.zip: the name must end in .fmu"),
        (["--fmu", "nowhere/rig.fmu"], "--fmu nowhere/rig.fmu: there is no folder nowhere"),
        (["--fmu", "rig.fmu", "--pty"], "--fmu serves nothing: leave out"),
        (["--fmu", "rig.fmu", "--rig", "no_such"], "no_such: no such file"),
    ],
)
def test_bad_input_of_the_command(
    options: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["firmware-sim", *options])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith(f"firmware-sim: {message}")


def test_a_step_past_the_stop_time_is_refused(unit: UnitFile) -> None:
    with unit.instance() as instance:
        instance.slave.setupExperiment(startTime=1.0, stopTime=2.0)
        instance.start()
        instance.step(SECOND, 2 * SECOND)
        with pytest.raises(FMICallException):
            instance.step(2 * SECOND, 3 * SECOND)
        assert instance.messages == ["fmi2DoStep: the step ends at 3 s, after the stop time of 2 s"]


def test_what_has_no_translation_is_refused_with_its_line() -> None:
    with pytest.raises(NotImplementedError, match=re.escape("f, line 2: 'x ** 2' has no translation to C")):
        c_code("def f(x: float) -> float:\n    return x**2\n")
    with pytest.raises(NotImplementedError, match="while x:"):
        c_code("def f(x: float) -> float:\n    while x:\n        x = 0.0\n    return x\n")


def test_a_parallel_assignment_uses_the_old_values() -> None:
    """Its translation must not change h1 before h2 is computed from it."""
    code = c_code("def f(h1: float, h2: float) -> float:\n    h1, h2 = h2, h1\n    return h1 - h2\n")
    assert re.search(r"new0 = h2;\s+const double new1 = h1;\s+h1 = new0;\s+h2 = new1;", code)
