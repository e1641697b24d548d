"""Frames decoded all at once are, number for number, what cantools decodes frame by frame."""

from __future__ import annotations

from typing import Any

import cantools
import numpy as np
import pytest
from cantools.database.can import Database

from hil.data.can_log import CanLog, parse_can_log, read_can_log
from hil.data.decode import decode
from hil.edge.record.run_folder import RunFolder
from tests.export.can_logs import kinds_database, random_log


@pytest.fixture(scope="module")
def kinds() -> Database:
    return kinds_database()


def assert_as_cantools(log: CanLog, database: Database) -> int:
    """Compare every value of every frame; returns how many frames were compared."""
    tables = decode(log, database)
    compared = 0
    for name, table in tables.items():
        message = database.get_message_by_name(name)
        for index, row in enumerate(table.rows):
            expected: Any = message.decode(bytes(log.data[row, : log.length[row]]), decode_choices=False)
            ours = {signal: column[index].item() for signal, column in table.columns.items()}
            absent = {signal: value for signal, value in ours.items() if signal not in expected}
            assert np.isnan([*absent.values()]).all(), absent
            for signal, value in expected.items():
                same = ours[signal] == value or (np.isnan(value) and np.isnan(ours[signal]))
                assert same, (name, signal, value, ours[signal])
            compared += 1
        assert table.time_s.tolist() == log.time_s[table.rows].tolist()
    return compared


def test_every_kind_of_signal_is_exactly_that_of_cantools(kinds: Database) -> None:
    log = parse_can_log(random_log(kinds, 1500, seed=5), "can.log")
    assert assert_as_cantools(log, kinds) == 1500


def test_a_recorded_run_is_exactly_that_of_cantools(bench_run: RunFolder) -> None:
    database = cantools.database.load_string(bench_run.manifest().plan.copies["bench.dbc"], "dbc")
    assert isinstance(database, Database)
    log = read_can_log(bench_run.can_log_path)
    assert assert_as_cantools(log, database) == len(log) > 800


def test_names_stay_numbers_with_a_mapping_and_units_are_there(kinds: Database) -> None:
    log = parse_can_log(b"(1.000000) can0 00000100#310000\n", "can.log")
    table = decode(log, kinds, ["Extended"])["Extended"]
    assert table["Mode"].tolist() == [1]
    assert table["Named"].tolist() == [7]
    assert table.choices == {"Mode": {0: "Off", 1: "On"}, "Named": {-1: "None", 7: "Three"}}
    assert decode(log, kinds)["Kinds"].units["SignedMotorola"] == "bar"


def test_frames_that_are_not_the_messages_data_are_left_out(kinds: Database) -> None:
    """Remote and error frames, the same number as the other kind of identifier, and frames that are too short."""
    text = (
        b"(1.000000) can0 100#R8\n(2.000000) can0 00000100#0000000000000000\n"
        b"(3.000000) can0 20000100#0000000000000000\n(4.000000) can0 100#00000000000000\n"
        b"(5.000000) can0 100#0000000000000000\n(6.000000) can0 104#0001020304\n"
    )
    tables = decode(parse_can_log(text, "can.log"), kinds)
    assert tables["Kinds"].time_s.tolist() == [5.0]
    assert tables["Kinds"].too_short == 1
    assert tables["Extended"].time_s.tolist() == [2.0]
    assert tables["Multiplexed"]["Always"].tolist() == [3], "bytes beyond its length are ignored"
    assert len(tables["Floats"]) == 0
    assert tables["Floats"]["Intel"].shape == (0,)


def test_differences_of_whole_numbers_do_not_wrap(kinds: Database) -> None:
    log = parse_can_log(b"(1.000000) can0 104#00FF0001\n(1.000000) can0 104#00000000\n", "can.log")
    assert np.diff(decode(log, kinds)["Multiplexed"]["Always"]).tolist() == [-1]


def test_an_unknown_message_is_a_key_error(kinds: Database) -> None:
    with pytest.raises(KeyError):
        decode(parse_can_log(b"", "can.log"), kinds, ["Nothing"])
