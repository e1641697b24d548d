"""From a run folder to a record: exact times, voltages of the moment of their command, means that cross no change."""

from pathlib import Path

import numpy as np
import pytest

from firmware_sim.rig import Rig as Emulator
from firmware_sim.settings import load, load_fingerprint
from hil.bench.experiment_run import EmulatedStage, ExperimentOptions, run_experiment
from hil.bench.identify_inputs import load_bench, records_of, rig_model
from hil.core.identification.robust_fit import fit_initial
from hil.core.identification.simulation import simulate
from hil.edge.config.settings_file import default_config_dir
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.level_records import Decoded, in_means, readings, record_of_folder, without_rounding

CONFIG = default_config_dir()


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """A short experiment on a rig without noise and without a converter at the sensors."""
    settings, _ = load(CONFIG / "emulator.toml", is_empty=True)
    quiet = settings.sensors.model_copy(update={"noise_V": 0.0, "adc_bits": 0})
    settings = settings.model_copy(update={"sensors": quiet})
    emulator = Emulator(settings, (), 1, load_fingerprint(CONFIG / "bench.dbc"))
    options = ExperimentOptions(minutes=1.0, rerun=False)
    out = tmp_path_factory.mktemp("records") / "x"
    folder = run_experiment(load_bench(None, None), options, EmulatedStage(emulator, 1), out, lambda *_: True)
    assert folder is not None
    return folder.runs()


def test_the_true_model_explains_every_record_to_the_steps_of_the_wire(runs: tuple[Path, ...]) -> None:
    """A record that began with the pumps running, for the model, was 25 mV off in its first second."""
    bench = load_bench(None, None)
    model = rig_model(bench.rig)
    fitted, held_out = records_of(runs)
    for record in (*fitted, *held_out):
        residual_V = simulate(model, record, fit_initial(model, record)).residuals
        inside = residual_V[np.isfinite(residual_V)]
        assert len(inside) > 100
        assert np.abs(inside).max() < 1e-3
        assert np.sqrt(np.mean(inside**2)) < 1.5e-4


def test_the_held_out_phase_is_kept_apart_and_the_first_begins_with_empty_tanks(runs: tuple[Path, ...]) -> None:
    fitted, held_out = records_of(runs)
    assert [record.name for record in held_out] == ["05_held_out"]
    assert fitted[0].initial_cm == (0.0, 0.0, 0.0, 0.0)
    assert np.isnan(fitted[1].initial_cm).all()


def test_every_record_begins_with_the_voltages_from_before_its_first_command(runs: tuple[Path, ...]) -> None:
    fitted, _ = records_of(runs)
    assert all((record.voltage_V[0] == 0.0).all() for record in fitted)


def test_means_give_the_same_as_single_readings(runs: tuple[Path, ...]) -> None:
    single = record_of_folder(runs[1], together=1)
    means = record_of_folder(runs[1], together=5)
    assert means.samples is not None
    assert means.samples.max() == 5
    assert len(means.time_s) < 0.5 * len(single.time_s)
    near = np.interp(means.time_s, single.time_s[1:-1], np.nan_to_num(single.reading_V[1:-1, 0]))
    inside = np.isfinite(means.reading_V[:, 0]) & (means.time_s > 1.0) & (means.time_s < 5.0)
    assert np.abs(near - means.reading_V[:, 0])[inside].max() < 2e-3


def test_no_mean_crosses_a_change_of_the_voltage_and_none_has_a_saturated_reading_in_it() -> None:
    time_s = np.arange(8.0)
    voltage_V = np.where(time_s[:, None] >= 3.0, 2.0, 1.0) * np.ones((8, 2))
    reading_V = np.column_stack([time_s, time_s, np.where(time_s > 5.0, 0.0, 1.0), np.zeros(8)])
    axis, volts, means, samples = in_means(time_s, voltage_V, reading_V, (0.0, 10.0), 3)
    taken = np.isfinite(means).any(axis=1)
    # the reading of 3 s is from before the change at 3 s
    assert axis[taken].tolist() == [0.0, 2.0, 5.0, 7.0]
    assert samples[taken, 0].tolist() == [1, 3, 3, 1]
    assert volts[taken, 0].tolist() == [1.0, 1.0, 2.0, 2.0]
    assert 3.0 in axis[~taken]
    assert np.isnan(means[taken][2, 2]), "two readings of it are fine, one is saturated"
    assert means[taken][3, 2] == 0.0


def test_voltages_that_lie_on_the_steps_of_a_converter_are_taken_as_those_steps() -> None:
    exact = np.array([[0, 1421], [1326, 380], [1705, 812], [2047, 90]]) * 10.0 / 4095
    reported = np.round(exact / 2e-4) * 2e-4
    assert np.abs(reported - exact).max() > 5e-5
    assert np.allclose(without_rounding(reported, (0.0, 10.0)), exact, rtol=0.0, atol=1e-12)
    free = np.array([[0.1234, 3.3332], [1.7778, 2.001], [4.0002, 0.5556], [9.7, 5.1112]])
    assert (without_rounding(free, (0.0, 10.0)) == free).all()


def test_readings_of_both_frames_belong_together_when_they_are_within_2_ms() -> None:
    """The frame of the upper tanks may come before or after that of the lower ones; one that is missing leaves NaN."""

    def levels(times_s: list[float], first: int) -> Decoded:
        columns = {f"Level{first + i}": np.array(times_s) * 10.0 + first + i for i in (0, 1)}
        columns |= {f"Status{first + i}": np.zeros(len(times_s)) for i in (0, 1)}
        return Decoded(np.array(times_s), columns)

    lower = levels([0.0, 0.02, 0.04, 0.06, 0.08, 0.08], 1)
    upper = levels([0.0, 0.021, 0.039, 0.065, 0.08], 3)
    upper.values["Status4"][0] = 1.0
    times_s, reading_V = readings(lower, upper)
    assert times_s.tolist() == [0.0, 0.02, 0.04, 0.06, 0.08], "the repeated frame counts once"
    assert np.allclose(reading_V[:, 0], times_s * 10.0 + 1.0)
    assert np.allclose(reading_V[:, 1], times_s * 10.0 + 2.0)
    assert np.allclose(reading_V[:, 2], [3.0, 3.21, 3.39, np.nan, 3.8], equal_nan=True)
    assert np.allclose(reading_V[:, 3], [np.nan, 4.21, 4.39, np.nan, 4.8], equal_nan=True)


def test_a_run_without_a_control_step_says_so(runs: tuple[Path, ...], tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "none", RunFolder.open(runs[0]).manifest().plan)
    with pytest.raises(RunFolderError, match="no control step"):
        record_of_folder(folder.path)
