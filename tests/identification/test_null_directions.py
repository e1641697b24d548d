"""Directions that the data do not determine, from sensitivities made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from hil.core.identification.null_directions import described, identifiability, listed
from hil.core.identification.records import LevelRecord

NAMES = ("k1", "a1", "sensor_gain1", "lag1")
VALUES = (3.3, 0.07, 0.5, 0.2)


def record(voltages: tuple[float, float] = (1.0, 3.0)) -> LevelRecord:
    voltage_V = np.array([[voltages[0]] * 2, [voltages[1]] * 2, [voltages[0]] * 2])
    return LevelRecord("r", np.arange(3.0), voltage_V, np.ones((3, 4)))


def rows() -> np.ndarray:
    """k1 and sensor_gain1 act alike, over their values; a1 and lag1 each in a row of its own."""
    return np.array([[1e3 / 3.3, 0.0, 1e3 / 0.5, 0.0], [0.0, 1e5, 0.0, 0.0], [0.0, 0.0, 0.0, 1e3]])


def test_parameters_known_only_together_are_not_identifiable() -> None:
    told = identifiability(rows(), np.zeros((4, 4)), NAMES, VALUES)
    assert told.undetermined == ("k1", "sensor_gain1")
    (direction,) = described(told, [record()], [np.full((3, 4), 10.0)])
    assert direction.names == ("k1", "sensor_gain1")
    assert direction.text == "k1 and sensor_gain1 can only be known together: read the level of tank 1 or 3 by a ruler"


def test_a_ruler_closes_the_direction() -> None:
    ruler = np.array([[10.0 / 3.3, 0.0, 0.0, 0.0]])
    told = identifiability(rows(), ruler.T @ ruler * 100.0, NAMES, VALUES)
    assert told.undetermined == ()
    assert not len(told.directions)


@pytest.mark.parametrize(
    ("voltages", "text"),
    [((2.0, 2.0), "neither pump moved: "), ((1.0, 3.0), "lag1 is not determined: ")],
)
def test_the_text_names_the_cause(voltages: tuple[float, float], text: str) -> None:
    blind = rows()
    blind[2] = 0.0
    told = identifiability(blind[:, [1, 3]], np.zeros((2, 2)), ("a1", "lag1"), (0.07, 0.2))
    (direction,) = described(told, [record(voltages)], [np.full((3, 4), 10.0)])
    assert direction.text.startswith(text)


def test_an_idle_pump_is_named() -> None:
    voltage_V = np.array([[1.0, 0.0], [3.0, 0.0], [1.0, 0.0]])
    one = LevelRecord("r", np.arange(3.0), voltage_V, np.ones((3, 4)))
    told = identifiability(np.zeros((1, 1)), np.zeros((1, 1)), ("k2",), (3.3,))
    (direction,) = described(told, [one], [np.full((3, 4), 10.0)])
    assert direction.text == "pump 2 never moved: k2 is not determined: a record is needed in which it moves"


def test_tanks_without_readings_are_named() -> None:
    one = record()
    reading_V = one.reading_V.copy()
    reading_V[:, 1] = np.nan
    told = identifiability(np.zeros((1, 1)), np.zeros((1, 1)), ("a2",), (0.06,))
    (direction,) = described(told, [replace(one, reading_V=reading_V)], [np.full((3, 4), 10.0)])
    assert direction.text.startswith("tank 2 without readings: a2 is not determined")


def test_names_in_a_sentence() -> None:
    gains = [f"sensor_gain{i}" for i in (1, 2, 3, 4)]
    assert listed(["k1", "k2", *gains]) == "k1, k2 and all four sensor gains"
    assert listed(["a3"]) == "a3"
