"""The cost of one frame: encoded, checked and decoded."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from typing import Any

import cantools

from hil.bench import assembly
from hil.wire.frame_check import FrameCheck, Rejection
from tools.benchmark import SCENARIO
from tools.benchmark.capture import Capture
from tools.benchmark.tables import Section, as_time
from tools.benchmark.timing import Effort, in_turns

COMMAND: dict[str, Any] = {
    "Command1": 3.1,
    "Command2": 2.9,
    "Enable": 1,
    "ClearTrip": 0,
    "StartPhase": 0,
    "Counter": 7,
    "Crc": 0,
}
"""Signals of the PumpCommand that is encoded."""


def codec(effort: Effort) -> list[Section]:
    """Encode, check and decode, per frame, beside cantools' own encode and decode (which know no CRC or counter)."""
    capture = Capture.of_a_run(60.0)
    bench = assembly.load(SCENARIO)
    specs = {spec.frame_id: spec for spec in bench.contract.frames.values()}
    database: Any = cantools.database.load_file(bench.dbc_path)
    command = bench.contract.frames["PumpCommand"]
    frames = capture.frames[:400]

    def admit() -> None:
        checks = {frame_id: FrameCheck(spec) for frame_id, spec in specs.items()}
        for frame in frames:
            found = checks[frame.arbitration_id].admit(frame, round(frame.timestamp * 1e9))
            if isinstance(found, Rejection):
                raise AssertionError(f"frame {frame} refused: {found}")

    def decode() -> None:
        for frame in frames:
            specs[frame.arbitration_id].decode(bytes(frame.data))

    def decode_by_cantools() -> None:
        for frame in frames:
            database.decode_message(frame.arbitration_id, frame.data, decode_choices=False)

    calls: dict[str, tuple[Callable[[], Any], int]] = {
        "encode, with CRC": (lambda: command.encode(COMMAND), 400),
        "cantools encode": (lambda: database.encode_message("PumpCommand", COMMAND), 400),
        "check and decode": (admit, 1),
        "decode alone": (decode, 1),
        "cantools decode": (decode_by_cantools, 1),
    }
    times = in_turns(calls, effort.rounds)
    for name in ("check and decode", "decode alone", "cantools decode"):
        times[name] = [value / len(frames) for value in times[name]]
    peers = {"encode, with CRC": "cantools encode", "check and decode": "cantools decode"}
    peers["decode alone"] = "cantools decode"
    rows = []
    for name, found in times.items():
        peer = peers.get(name)
        ratio = median(theirs / mine for theirs, mine in zip(times[peer], found, strict=True)) if peer else None
        rows.append((name, as_time(median(found)), as_time(min(found)), "" if ratio is None else f"{ratio:.1f}"))
    both = [e + d for e, d in zip(times["encode, with CRC"], times["check and decode"], strict=True)]
    rows.append(("encode + check + decode", as_time(median(both)), as_time(min(both)), ""))
    note = (
        "Per frame; PumpCommand for encoding, the frames of a run in their order for checking. "
        "Ratio: cantools' time over ours."
    )
    return [Section("Codec", note, ("what", "median", "best", "ratio"), rows)]
