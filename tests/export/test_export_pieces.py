"""A long run is exported a stretch at a time: the same content as all at once, in the order of time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.export import export_tables, matlab_file, mcap_chunks
from hil.export.formats import export_run
from hil.export.in_order import InOrder
from hil.export.mcap_chunks import MessageRows
from hil.review import ticks

SECOND_NS = 1_000_000_000


@pytest.fixture
def in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the tables of the test were larger than what is read at once."""
    monkeypatch.setattr(ticks, "LARGE_BYTES", 1)
    monkeypatch.setattr(ticks, "PIECE_BYTES", 1 << 15)
    monkeypatch.setattr(export_tables, "PIECE_BYTES", 20_000)
    monkeypatch.setattr(mcap_chunks, "CHUNK_BYTES", 5_000)


def messages_of(path: Path) -> list[tuple[str, int, int, bytes]]:
    """As the format's own library reads them, with the check sums of all parts."""
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages()
        return [(channel.topic, message.log_time, message.sequence, message.data) for _, channel, message in found]


@pytest.fixture(scope="module")
def at_once(bench_run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both formats, of a run that is short enough for one piece."""
    folder = tmp_path_factory.mktemp("at_once")
    export_run(bench_run.path, "parquet", folder / "run_parquet")
    export_run(bench_run.path, "mcap", folder / "run.mcap")
    return folder


@pytest.mark.usefixtures("in_pieces")
def test_mcap_in_pieces_has_the_same_messages_in_order(bench_run: RunFolder, at_once: Path, tmp_path: Path) -> None:
    """All messages of a run were kept as Python objects: a day took more memory than a computer of a bench has."""
    whole = messages_of(at_once / "run.mcap")
    pieces = messages_of(export_run(bench_run.path, "mcap", tmp_path / "run.mcap"))
    assert sorted(pieces) == sorted(whole)
    times_ns = [at_ns for _, at_ns, _, _ in pieces]
    assert times_ns == sorted(times_ns)
    for topic in {topic for topic, *_ in whole}:
        assert [one for one in pieces if one[0] == topic] == [one for one in whole if one[0] == topic]


@pytest.mark.usefixtures("in_pieces")
def test_parquet_in_pieces_has_the_same_rows(bench_run: RunFolder, at_once: Path, tmp_path: Path) -> None:
    out = export_run(bench_run.path, "parquet", tmp_path / "out")
    names = sorted(path.relative_to(out) for path in out.rglob("*.parquet"))
    assert names == sorted(path.relative_to(at_once / "run_parquet") for path in at_once.rglob("*.parquet"))
    for name in names:
        whole = pd.read_parquet(at_once / "run_parquet" / name)
        pieces = pd.read_parquet(out / name)
        pd.testing.assert_frame_equal(pieces, whole, check_exact=True)
        assert pieces.attrs == whole.attrs


def test_a_run_that_does_not_fit_into_a_file_of_matlab_is_refused(
    bench_run: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matlab_file, "MAX_FRAMES", 100)
    with pytest.raises(RunFolderError, match=r"--to mat takes at most 100 frames, .* use --to parquet"):
        export_run(bench_run.path, "mat", tmp_path / "run.mat")
    assert not list(tmp_path.iterdir())


def rows(channel: int, *times_s: float) -> MessageRows:
    times_ns = np.array([round(t_s * SECOND_NS) for t_s in times_s], dtype=np.int64)
    return MessageRows.of(channel, times_ns, np.arange(len(times_ns)), np.zeros((len(times_ns), 1), np.uint8))


def test_nothing_is_handed_on_that_a_later_stretch_could_be_earlier_than() -> None:
    """Lines of a log are up to a second later than their neighbours; after a clock was set back, order is given up."""
    slow = iter([[rows(1, 0.0, 50.0)], [rows(1, 60.0)]])
    quick = iter([[rows(2, 0.5, 3.0, 2.5)], [rows(2, 2.2, 9.0)], [], [rows(2, 70.0, 1.0)]])
    found = [
        [(one.channel, t / SECOND_NS) for one in part for t in one.time_ns.tolist()] for part in InOrder([slow, quick])
    ]
    flat: list[Any] = [one for part in found for one in sorted(part, key=lambda item: item[1])]
    assert sorted(flat) == sorted(
        [(1, 0.0), (1, 50.0), (1, 60.0), *((2, t) for t in (0.5, 3.0, 2.5, 2.2, 9.0, 70.0, 1.0))]
    )
    in_order = [t for _, t in flat if t != 1.0]
    assert in_order == sorted(in_order)
