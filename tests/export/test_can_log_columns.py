"""A log of frames read as columns: the same frames as python-can reads, and clear words for what is damaged."""

from __future__ import annotations

import gzip
from pathlib import Path

import can
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.data.can_log import CanLog, DamagedLogError, can_log_blocks, joined, parse_can_log, read_can_log
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from tests.export.can_logs import kinds_database, random_log

ODD = (
    "(0.000001) can0 201#\n"
    "(10.250000) can0 01ABCDEF#0102\n"
    "(1700000000.123456) vcan1 123#R4\n"
    "(1700000000.123457) vcan1 123#R\n"
    "\n"
    "(1700000000.123458) vcan1 20000080#0000000000000000\n"
    "(1700000000.5) can0 7ff#DEADbeef01020304 T\n"
    "(1700000000.123456789) can0 123#01 R\r\n"
)


def frames_of(log: CanLog) -> list[tuple[object, ...]]:
    return [
        (t, log.channels[c], i, bytes(d[:n]) if not r else n, x, r, e)
        for t, c, i, n, d, x, r, e in zip(
            log.time_s.tolist(), log.channel, log.arbitration_id.tolist(), log.length.tolist(), log.data,
            log.is_extended, log.is_remote, log.is_error, strict=True,
        )
    ]  # fmt: skip


def frames_of_python_can(path: Path) -> list[tuple[object, ...]]:
    with can.CanutilsLogReader(path) as reader:
        return [
            (m.timestamp, m.channel, m.arbitration_id, m.dlc if m.is_remote_frame else bytes(m.data),
             m.is_extended_id, m.is_remote_frame, m.is_error_frame)
            for m in reader
        ]  # fmt: skip


def test_a_recorded_log_reads_as_python_can_reads_it(bench_run: RunFolder) -> None:
    log = read_can_log(bench_run.can_log_path)
    assert frames_of(log) == frames_of_python_can(bench_run.can_log_path)
    assert log.channels == ("can0",)
    assert not log.data.flags.writeable


def test_every_kind_of_line_is_read(tmp_path: Path) -> None:
    path = tmp_path / "odd.log"
    path.write_bytes(ODD.encode())
    log = read_can_log(path)
    expected = frames_of_python_can(path)
    assert expected[4][-1], "python-can knows the error frame, too"
    expected[4] = (
        expected[4][0],
        "vcan1",
        0x80,
        bytes(8),
        False,
        False,
        True,
    )  # it keeps neither channel nor class nor data
    assert frames_of(log) == expected
    assert set(log.channels) == {"can0", "vcan1"}


@pytest.mark.parametrize("suffix", [".gz", ".zst"])
def test_a_compressed_log_is_found_and_read_alike(bench_run: RunFolder, tmp_path: Path, suffix: str) -> None:
    text = bench_run.can_log_path.read_bytes()
    path = tmp_path / f"can.log{suffix}"
    if suffix == ".gz":
        path.write_bytes(gzip.compress(text[:3000]) + gzip.compress(text[3000:]))
    else:
        with pa.output_stream(str(path), compression="zstd") as stream:
            stream.write(text)
    for named in (path, tmp_path / "can.log"):
        assert frames_of(read_can_log(named)) == frames_of(read_can_log(bench_run.can_log_path))


@pytest.mark.parametrize("suffix", ["", ".gz", ".zst"])
def test_what_cannot_be_read_is_an_error_with_the_files_name(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"can.log{suffix}"
    with pytest.raises(RunFolderError, match=r"cannot read .*can\.log"):
        read_can_log(path)
    path.write_bytes(b"(1.000000) can0 201#00\n" if suffix else b"\x00\xff\n")
    with pytest.raises(RunFolderError, match=r"can\.log"):
        read_can_log(path)


def test_a_compressed_log_that_is_cut_off_is_an_error(tmp_path: Path) -> None:
    text = random_log(kinds_database(), 500, seed=1)
    path = tmp_path / "can.log.gz"
    path.write_bytes(gzip.compress(text)[:-200])
    with pytest.raises(RunFolderError, match=r"cannot read .*can\.log\.gz"):
        read_can_log(path)


@given(st.integers(0, 2000))
def test_a_half_last_line_is_left_out(cut: int) -> None:
    """As a killed run may leave it: never an error, never a wrong frame."""
    text = random_log(kinds_database(), 40, seed=2)
    whole = frames_of(parse_can_log(text, "can.log"))
    cut = min(cut, len(text))
    assert frames_of(parse_can_log(text[:cut], "can.log")) == whole[: text[:cut].count(b"\n")]


@pytest.mark.parametrize(
    "line",
    [
        "201#00", "(1.000000) can0 201#0", "(1.000000) can0 2G1#00", "(1.000000) can0 201#0G", "(1.00000x) can0 201#00",
        "(1.000000) can0 201#000000000000000000", "(1.000000) can0 201#R9", "(1.000000) can0  201#00",
        "(1) can0 201#00", "(1.000000) can0 201#00 X", "\x80",
        f"({'1' * 300}.0) can0 201#00", "x" * 10_000,
    ],
)  # fmt: skip
def test_a_damaged_line_is_named_with_its_number(line: str) -> None:
    text = random_log(kinds_database(), 100, seed=3).decode().splitlines(keepends=True)
    text.insert(70, line + "\n")
    text.insert(80, "(1.000000) can0 20\n")
    with pytest.raises(DamagedLogError, match=r"^run/can\.log, line 71 is not a frame as candump -L writes it: "):
        parse_can_log("".join(text).encode("latin1"), "run/can.log")


def test_a_frame_of_can_fd_is_refused() -> None:
    with pytest.raises(DamagedLogError, match=r"line 1 is a CAN FD frame, only classic CAN is read: .*123##1"):
        parse_can_log(b"(1.000000) can0 123##1001122\n", "fd.log")


def test_blocks_are_the_log_whatever_their_size_and_count_lines_through(tmp_path: Path) -> None:
    path = tmp_path / "can.log"
    path.write_bytes(random_log(kinds_database(), 300, seed=4) + ODD.encode() + b"(1.000000) ca")
    whole = read_can_log(path)
    for size in (7, 50, 1000):
        blocks = list(can_log_blocks(path, size))
        assert len(blocks) > 2
        assert frames_of(joined(blocks)) == frames_of(whole)
    path.write_bytes(path.read_bytes() + b"\n")
    with pytest.raises(DamagedLogError, match=r"line 309 "):
        list(can_log_blocks(path, 100))


def test_more_channels_than_a_column_can_number_are_refused() -> None:
    with pytest.raises(DamagedLogError, match=r"can\.log has more than 255 channels"):
        parse_can_log("".join(f"(1.000000) can{n} 123#\n" for n in range(300)).encode(), "can.log")


def test_an_empty_log_has_no_frames(tmp_path: Path) -> None:
    (tmp_path / "can.log").touch()
    assert len(read_can_log(tmp_path / "can.log")) == 0
