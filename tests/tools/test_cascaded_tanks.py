"""The benchmark on a real record: how the record becomes one of a four-tank rig, and the error where the file is."""

import os
from pathlib import Path

import numpy as np
import pytest

from hil.core.identification.simulation import simulate
from tools.benchmark import cascaded_tanks, identify

RECORD = os.environ.get("FOURTANK_CASCADED_TANKS", "")


def test_a_record_of_the_model_is_read_and_predicted_exactly(tmp_path: Path) -> None:
    """Columns of the published file: an empty last one, and a sample time in the first row only."""
    start = cascaded_tanks.start_model(9.0)
    voltage_V = np.repeat([3.0, 6.0, 1.0, 4.0], 20)
    plain = cascaded_tanks.record_of("made", voltage_V, np.full(80, 5.0))
    made = simulate(start, plain, (5.0, 0.0, 4.0, 0.0)).predicted_V[:, 0]
    lines = [f"{v},{v},{y},{y},," for v, y in zip(voltage_V.tolist(), made.tolist(), strict=True)]
    file = tmp_path / "tanks.csv"
    file.write_text("uEst,uVal,yEst,yVal,Ts,\n" + "\n".join(lines) + "\n")
    estimation, test = cascaded_tanks.load(file)
    assert estimation.voltage_V[:, 0].max() == 0.0, "pump 1 does not run"
    assert np.isnan(test.reading_V[:, 1:]).all(), "only the lower tank has a sensor"
    assert made.max() == pytest.approx(10.0), "its readings end at 10 V"
    assert cascaded_tanks.simulation_error(start, test, (5.0, 0.0, 4.0, 0.0)) < 1e-9


def test_another_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "other.csv"
    file.write_text("a,b\n1,2\n")
    assert identify.main(["--cascaded-tanks", str(file)]) == 2
    assert "wanted the columns uEst, yEst, uVal, yVal" in capsys.readouterr().err
    assert identify.main(["--cascaded-tanks", str(tmp_path / "none.csv")]) == 2


@pytest.mark.long
@pytest.mark.skipif(not RECORD, reason="FOURTANK_CASCADED_TANKS does not name the record")
def test_the_predicted_half_is_as_close_as_the_physics_allows() -> None:
    estimation, test = cascaded_tanks.load(Path(RECORD))
    results = [cascaded_tanks.best(estimation, test, structure) for structure in cascaded_tanks.STRUCTURES]
    chosen = min(results, key=lambda result: result.rmse_V)
    assert chosen.test_rmse_V <= 0.33
