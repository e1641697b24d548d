"""Exported runs, opened by other people's readers: the same numbers, units and frames."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections import Counter
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import can
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat

from hil.data.can_log import read_can_log
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.export.export_tables import read_run
from hil.export.formats import FORMATS, compress_logs, export_run
from hil.review.ticks import read_events, read_ticks

Frames = list[tuple[int, int, bool, bytes]]
"""Time in µs since the epoch, identifier, whether it is extended, data."""


def exported(run: RunFolder, to: str, folder: Path) -> Path:
    return export_run(run.path, to, folder / f"run{FORMATS[to].suffix}")


def frames_of(run: RunFolder) -> Frames:
    """As python-can reads the folder's log."""
    with can.CanutilsLogReader(run.can_log_path) as reader:
        return [(round(m.timestamp * 1e6), m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in reader]


@pytest.fixture(scope="module")
def parquet(bench_run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(bench_run, "parquet", tmp_path_factory.mktemp("parquet"))


@pytest.fixture(scope="module")
def csv(bench_run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(bench_run, "csv", tmp_path_factory.mktemp("csv"))


@pytest.fixture(scope="module")
def mf4(bench_run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(bench_run, "mf4", tmp_path_factory.mktemp("mf4"))


@pytest.fixture(scope="module")
def mat(bench_run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(bench_run, "mat", tmp_path_factory.mktemp("mat"))


def test_parquet_has_the_ticks_with_units_for_pandas_and_polars(bench_run: RunFolder, parquet: Path) -> None:
    ticks = read_ticks(bench_run.ticks_path)
    frame = pd.read_parquet(parquet / "ticks.parquet")
    assert list(frame.columns) == list(ticks.columns)
    for name in ticks.columns:
        np.testing.assert_array_equal(frame[name].to_numpy(), ticks[name])
    assert frame.attrs["units"]["h1_V"] == "V"
    assert frame.attrs["scenario"] == "steps"
    field = pq.read_schema(parquet / "ticks.parquet").field("v1_V")
    assert field.metadata[b"unit"] == b"V"
    assert field.metadata[b"meaning"]
    assert pl.read_parquet(parquet / "ticks.parquet")["h1_V"].to_list() == ticks["h1_V"].tolist()


def test_parquet_has_the_frames_and_the_events(bench_run: RunFolder, parquet: Path) -> None:
    frames = pl.read_parquet(parquet / "frames.parquet")
    found = zip(frames["time_s"], frames["arbitration_id"], frames["is_extended"], frames["data"], strict=True)
    assert [(round(t * 1e6), i, x, data) for t, i, x, data in found] == frames_of(bench_run)
    assert frames["is_sent"].sum() == len(bench_run.sent_log_path.read_text().splitlines())
    events = pd.read_parquet(parquet / "events.parquet")
    recorded = read_events(bench_run.events_path)
    assert [json.loads(data) for data in events["data"]] == [event.data for event in recorded]
    assert events["code"].tolist() == [event.code for event in recorded]


def test_parquet_has_the_signals_of_each_message(bench_run: RunFolder, parquet: Path) -> None:
    levels = pd.read_parquet(parquet / "signals/LowerLevels.parquet")
    assert levels.attrs["units"] == {
        "time_s": "s", "t_s": "s", "Level1": "V", "Level2": "V", "Status1": "", "Status2": "", "Counter": "", "Crc": "",
    }  # fmt: skip
    assert np.abs(levels["Level1"].mean() - read_ticks(bench_run.ticks_path)["h1_V"].mean()) < 0.05
    state = pq.read_schema(parquet / "signals/PumpStatus.parquet").field("State")
    assert json.loads(state.metadata[b"choices"]) == {"0": "Boot", "1": "Ready", "2": "Run", "3": "Tripped"}
    zero_s = bench_run.manifest().clock.run_zero_epoch_s
    assert levels["t_s"].tolist() == [round(t - (zero_s or 0.0), 6) for t in levels["time_s"]]


def test_csv_has_the_same_tables_as_parquet_and_a_list_of_units(parquet: Path, csv: Path) -> None:
    names = sorted(path.relative_to(csv).with_suffix("") for path in csv.rglob("*.csv") if path.name != "units.csv")
    assert names == sorted(path.relative_to(parquet).with_suffix("") for path in parquet.rglob("*.parquet"))
    for name in names:
        text = pd.read_csv(csv / f"{name}.csv", dtype={"data": str}, keep_default_na=False, na_values=[""])
        binary = pd.read_parquet(parquet / f"{name}.parquet")
        if name.name == "frames":
            binary["data"] = [data.hex().upper() for data in binary["data"]]
        pd.testing.assert_frame_equal(text, binary, check_dtype=False, check_exact=True)
    units = pd.read_csv(csv / "units.csv", keep_default_na=False).set_index(["file", "column"])
    assert units.loc[("ticks.csv", "true_h1_cm"), "unit"] == "cm"
    assert json.loads(units.loc[("signals/PumpStatus.csv", "TripCause"), "choices"])["1"] == "Watchdog"
    assert pl.read_csv(csv / "ticks.csv")["h1_V"].dtype == pl.Float64


def test_mf4_is_bus_logging_with_the_dbc_from_which_asammdf_decodes(
    bench_run: RunFolder, mf4: Path, tmp_path: Path
) -> None:
    from asammdf import MDF

    with MDF(mf4) as file:
        text, name, _ = file.extract_attachment(0)
        assert not isinstance(text, str)
        assert (Path(name).name, bytes(text).decode()) == ("bench.dbc", bench_run.manifest().plan.copies["bench.dbc"])
        (tmp_path / "embedded.dbc").write_bytes(text)
        zero_s = bench_run.manifest().clock.run_zero_epoch_s or 0.0
        assert file.start_time.timestamp() == pytest.approx(zero_s, abs=1e-6)
        with file.extract_bus_logging({"CAN": [(tmp_path / "embedded.dbc", 0)]}) as extracted:
            theirs = extracted.get("Level3")
        tables = {table.name: table for table in read_run(bench_run.path).messages()}
        ours = {column.name: column.values for column in tables["UpperLevels"].columns}
        assert theirs.unit == "V"
        np.testing.assert_allclose(theirs.samples, ours["Level3"], rtol=0, atol=1e-12)
        np.testing.assert_allclose(theirs.timestamps, ours["t_s"], rtol=0, atol=1e-9)


def test_mf4_has_decoded_signals_ticks_and_events(bench_run: RunFolder, mf4: Path) -> None:
    from asammdf import MDF

    with MDF(mf4) as file:
        all_groups: Any = file.groups
        groups = {group.channel_group.acq_name: index for index, group in enumerate(all_groups)}
        h1 = file.get("h1_V", group=groups["ticks"])
        ticks = read_ticks(bench_run.ticks_path)
        assert (h1.unit, h1.samples.tolist()) == ("V", ticks["h1_V"].tolist())
        np.testing.assert_allclose(h1.timestamps, ticks["t_s"], rtol=0, atol=1e-6)
        state = file.get("State", group=groups["PumpStatus"])
        assert {bytes(name) for name in state.samples} >= {b"Boot", b"Run"}
        assert set(file.get("State", group=groups["PumpStatus"], raw=True).samples.tolist()) <= {0, 1, 2, 3}
        codes = file.get("code", group=groups["events"]).samples
        assert [bytes(c).decode() for c in codes] == [event.code for event in read_events(bench_run.events_path)]


def test_frames_of_mf4_are_those_of_the_log_for_python_can(bench_run: RunFolder, mf4: Path) -> None:
    with mf4_reader_of_python_can()(mf4) as reader:
        messages = list(reader)
    found = [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in messages]
    expected = frames_of(bench_run)
    assert found == [frame[1:] for frame in expected]
    times_s = np.array([m.timestamp for m in messages])
    np.testing.assert_allclose(times_s, [frame[0] * 1e-6 for frame in expected], rtol=0, atol=1e-6)
    sent = read_can_log(bench_run.sent_log_path)
    assert sum(not m.is_rx for m in messages) == len(sent)


def mf4_reader_of_python_can() -> Any:
    """From a second copy of its module: `import hil` keeps asammdf out of the first (`hil.lean_start`)."""
    import can.io.mf4

    spec = spec_from_file_location("can.io.mf4_with_asammdf", can.io.mf4.__file__)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.MF4Reader


def test_mat_is_a_struct_with_tables_and_units_for_scipy(bench_run: RunFolder, mat: Path) -> None:
    record = loadmat(mat, simplify_cells=True)["record"]
    ticks = read_ticks(bench_run.ticks_path)
    for name in ticks.columns:
        np.testing.assert_array_equal(record["ticks"][name], ticks[name])
    assert record["units"]["ticks"]["h1_V"] == "V"
    assert record["units"]["signals"]["LowerLevels"]["Level1"] == "V"
    assert [str(code) for code in record["events"]["code"]] == [e.code for e in read_events(bench_run.events_path)]
    frames = record["frames"]
    rows: Any = zip(frames["time_s"], frames["arbitration_id"], frames["data"], frames["length"], strict=True)
    assert [(round(t * 1e6), int(i), bytes(d[: int(n)])) for t, i, d, n in rows] == [
        (t, i, data) for t, i, _, data in frames_of(bench_run)
    ]
    assert record["choices"]["PumpStatus"]["State"].tolist() == [[0, "Boot"], [1, "Ready"], [2, "Run"], [3, "Tripped"]]
    assert record["info"]["scenario"] == "steps"


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="needs octave-cli (Debian package octave)")
def test_octave_reads_the_struct(bench_run: RunFolder, mat: Path) -> None:
    ticks = read_ticks(bench_run.ticks_path)
    script = (
        f"load('{mat}'); printf('%d %.17g %s %s %s %s\\n', numel(record.ticks.t_s), sum(record.ticks.h1_V), "
        "record.units.ticks.h1_V, record.events.code{1}, record.choices.PumpStatus.State{4, 2}, "
        "record.frames.data_hex{end});"
    )
    done = subprocess.run(
        ["octave-cli", "--norc", "--eval", script], capture_output=True, text=True, check=True, timeout=60.0
    )
    count, total, unit, code, state, data = done.stdout.split()
    assert (int(count), unit, state) == (len(ticks), "V", "Tripped")
    assert float(total) == pytest.approx(float(ticks["h1_V"].sum()), rel=1e-12)
    assert (code, data) == (read_events(bench_run.events_path)[0].code, frames_of(bench_run)[-1][3].hex().upper())


@pytest.mark.parametrize("compress", [None, "gz", "zst"])
def test_candump_is_the_log_plain_or_compressed(bench_run: RunFolder, tmp_path: Path, compress: str | None) -> None:
    out = export_run(bench_run.path, "candump", tmp_path / f"run.log{'.' + compress if compress else ''}", compress)
    again = read_can_log(out)
    assert again.time_s.tolist() == read_can_log(bench_run.can_log_path).time_s.tolist()
    if compress is None:
        assert out.read_bytes() == bench_run.can_log_path.read_bytes()
    else:
        assert out.stat().st_size < bench_run.can_log_path.stat().st_size / 3


@pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark (Wireshark)")
def test_wireshark_reads_the_candump_of_a_compressed_log(bench_run: RunFolder, tmp_path: Path) -> None:
    shutil.copytree(bench_run.path, tmp_path / "run")
    compress_logs(tmp_path / "run", "zst")
    out = export_run(tmp_path / "run", "candump", tmp_path / "plain.log")
    command = ["tshark", "-r", str(out), "-T", "fields", "-e", "can.id"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60.0)
    assert [int(number, 0) for number in done.stdout.split()] == [frame[1] for frame in frames_of(bench_run)]


def test_compressed_in_place_all_of_a_folder_is_read_as_before(bench_run: RunFolder, tmp_path: Path) -> None:
    from hil.review.level_records import record_of_folder

    run = tmp_path / "run"
    shutil.copytree(bench_run.path, run)
    before = record_of_folder(run)
    made = compress_logs(run, "gz")
    assert {path.name for path in made} == {"can.log.gz", "sent.log.gz"}
    assert not (run / "can.log").exists()
    assert not [path for path in run.iterdir() if path.name.startswith(".")]
    np.testing.assert_array_equal(record_of_folder(run).reading_V, before.reading_V)
    assert read_run(run).is_sent.sum() == read_run(bench_run.path).is_sent.sum() > 0
    with pytest.raises(RunFolderError, match="no log that is not compressed"):
        compress_logs(run, "zst")


@pytest.fixture(scope="module")
def mcap(bench_run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(bench_run, "mcap", tmp_path_factory.mktemp("mcap"))


def test_mcap_has_topics_with_schemas_in_the_order_of_time(bench_run: RunFolder, mcap: Path) -> None:
    from mcap.reader import make_reader

    with mcap.open("rb") as stream:
        reader = make_reader(stream)
        messages = [(schema, channel, message) for schema, channel, message in reader.iter_messages()]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {record.name: record.data for record in reader.iter_attachments()}
    times_ns = [message.log_time for _, _, message in messages]
    assert times_ns == sorted(times_ns)
    counts = Counter(channel.topic for _, channel, _ in messages)
    frames = frames_of(bench_run)
    assert counts["/ticks"] == len(read_ticks(bench_run.ticks_path))
    assert counts["/frames"] == len(frames) == sum(n for topic, n in counts.items() if topic.startswith("/signals/"))
    assert {schema.encoding for schema, _, _ in messages if schema} == {"protobuf"}
    units = {channel.topic: channel.metadata for _, channel, _ in messages}
    assert units["/ticks"]["unit.h1_V"] == units["/signals/LowerLevels"]["unit.Level1"] == "V"
    assert units["/signals/PumpStatus"]["choices.State"] == "0: Boot, 1: Ready, 2: Run, 3: Tripped"
    assert metadata["run"]["scenario"] == "steps"
    assert attachments["bench.dbc"].decode() == bench_run.manifest().plan.copies["bench.dbc"]
    assert [message.log_time for _, channel, message in messages if channel.topic == "/frames"] == sorted(
        frame[0] * 1000 for frame in frames
    )


def test_rerun_decodes_the_messages_of_mcap(bench_run: RunFolder, mcap: Path) -> None:
    """A reader of Protocol Buffers that is not ours; it shows the events as lines of a log."""
    found = read_by_rerun(mcap)
    ticks = read_ticks(bench_run.ticks_path)
    rows = [row["fourtank.Ticks:message"][0] for row in found["/ticks"]]
    for name in ticks.columns:
        np.testing.assert_array_equal([row[name] for row in rows], ticks[name])
    frames = [row["fourtank.Frames:message"][0] for row in found["/frames"]]
    assert [
        (round(f["time_s"] * 1e6), f["arbitration_id"], f["is_extended"], bytes(f["data"])) for f in frames
    ] == frames_of(bench_run)
    assert {frame["channel"] for frame in frames} == {"can0"}
    events = read_events(bench_run.events_path)
    assert [row["TextLog:text"][0] for row in found["/log"]] == [event.text for event in events]
    rows = [row["fourtank.Events:message"][0] for row in found["/events"]]
    assert [json.loads(row["data"]) for row in rows] == [event.data for event in events]


def read_by_rerun(path: Path) -> dict[str, list[dict[str, Any]]]:
    """The rows of each topic."""
    from rerun.chunk import McapReader

    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in McapReader(path).stream().to_chunks():
        if not chunk.is_static:
            found.setdefault(chunk.entity_path, []).extend(chunk.to_record_batch().to_pylist())
    return found
