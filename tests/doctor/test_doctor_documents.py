"""The rig's documents say what the code and the DBC say."""

import ast
import re
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
from can import Message
from cantools.database.can import Database
from crccheck.crc import Crc8Autosar

import firmware_sim.cli
from firmware_sim.frames import COUNTER_STEP_MAX, parse_command
from firmware_sim.frames import Rejection as NodeRejection
from firmware_sim.pump_node import PumpNode
from hil.cli import exit_codes, result_table
from hil.conformance import suite
from hil.core.alarm_catalogue import EVENT_BY_CODE, FAULT_BY_KIND, TRIP_BY_CAUSE, Explanation
from hil.core.interlocks import INTERLOCKS
from hil.core.types import TripCause
from hil.doctor import check_echo, check_frames, check_host, check_ramp, check_sensors, check_watchdog
from hil.doctor.check_link import check_lines, check_link
from hil.wire.frame_check import MAX_COUNTER_STEP, FrameCheck, Rejection
from tests.doctor.doctor_bench import contract, examined
from tools.reference import FOLDER
from tools.reference.pages import PAGES

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
GOLDEN = tomllib.loads((ROOT / "tests/golden/frames.toml").read_text())


def tables(name: str) -> list[tuple[tuple[str, ...], list[tuple[str, ...]]]]:
    """Every table of a document: its heading, and its rows as cells."""
    found: list[tuple[tuple[str, ...], list[tuple[str, ...]]]] = []
    heading: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = []
    for line in [*(DOCS / name).read_text().splitlines(), ""]:
        cells = tuple(cell.strip() for cell in line.strip().strip("|").split("|")) if line.startswith("|") else None
        if cells is None:
            if heading:
                found.append((heading, rows))
            heading, rows = (), []
        elif not heading:
            heading = cells
        elif set("".join(cells)) - set("-:"):
            rows.append(cells)
    return found


def rows_of(name: str, *heading: str) -> list[tuple[str, ...]]:
    return next(rows for head, rows in tables(name) if head[: len(heading)] == heading)


def plain(cell: str) -> str:
    return cell.strip("`")


def database() -> Database:
    import cantools

    loaded = cantools.database.load_file(str(ROOT / "config/bench.dbc"), cache_dir=None)
    assert isinstance(loaded, Database)
    return loaded


def test_every_cause_of_a_trip_is_explained_once() -> None:
    assert [plain(row[0]) for row in rows_of("how-to/operating.md", "cause")] == [cause.value for cause in TripCause]
    assert {interlock.cause for interlock in INTERLOCKS} <= set(TripCause)


def test_settings_named_for_a_trip_are_the_rig_file_s() -> None:
    rig = tomllib.loads((ROOT / "config/rig.toml").read_text())
    for _, what, _, _ in rows_of("how-to/operating.md", "cause"):
        section = ""
        for name in re.findall(r"`([a-zA-Z_.]+)(?: = [^`]*)?`", what):
            section, _, key = name.rpartition(".") if "." in name else (section, "", name)
            if section == "bench":
                continue  # bench.dbc
            assert key in rig[section], f"{name} in {what!r}"


@pytest.mark.parametrize(
    ("heading", "explained"), [("cause", TRIP_BY_CAUSE), ("kind", FAULT_BY_KIND), ("event", EVENT_BY_CODE)]
)
def test_alarms_are_explained_in_the_same_words(heading: str, explained: Mapping[str, Explanation]) -> None:
    rows = {plain(row[0]): row[1:] for row in rows_of("how-to/operating.md", heading)}
    assert list(rows) == list(explained)
    for name, row in explained.items():
        time = f"{row.respond_s:g} s" if row.respond_s < 120.0 else f"{row.respond_s / 60.0:g} min"
        words = [re.sub(r"\[([^]]+)\]\([^)]*\)", r"\1", cell).replace("**", "") for cell in rows[name]]
        assert words == [row.cause, row.action, f"{row.priority.value}, {time}"]


def event_codes() -> set[object]:
    """Second argument of every Event(...) in hil, by its source."""
    codes: set[object] = set()
    for file in (ROOT / "hil").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Event"):
                continue
            if len(node.args) > 1 and file.name != "law_check.py":  # which hands on an event whose code it has checked
                assert isinstance(node.args[1], ast.Constant), f"{file}:{node.lineno}"
                codes.add(node.args[1].value)
    return codes


def test_every_event_code_is_explained_once() -> None:
    explained = [plain(row[0]) for row in rows_of("how-to/operating.md", "code")]
    assert len(explained) == len(set(explained))
    assert set(explained) == event_codes()


def test_every_exit_code_is_explained_once() -> None:
    explained = [(plain(row[0]), int(row[1])) for row in rows_of("how-to/operating.md", "program")]
    of_hil = {0, exit_codes.BAD_INPUT, exit_codes.BROKEN_INVARIANT, exit_codes.INCOMPLETE, result_table.EXIT_FAILED}
    of_hil |= {exit_codes.LIMIT_NOT_KEPT, *exit_codes.BY_STATUS.values(), *exit_codes.BY_SIGNAL.values()}
    of_emulator = {0, firmware_sim.cli.FAILED, firmware_sim.cli.BAD_INPUT}
    assert len(explained) == len(set(explained))
    assert set(explained) == {("hil", c) for c in of_hil} | {("firmware-sim", c) for c in of_emulator}


def test_frames_are_the_dbc_s() -> None:
    rows = rows_of("reference/wire.md", "frame", "identifier")
    assert {plain(row[0]) for row in rows} == {message.name for message in database().messages}
    senders = {"controller": "CONTROLLER", "pump node": "PUMPS", "level node": "LEVELS"}
    for name, frame_id, length, sender, every, data_id in rows:
        message = database().get_message_by_name(plain(name))
        assert (message.frame_id, message.length) == (int(frame_id, 16), int(length))
        assert message.senders == [senders[sender]]
        assert every == (f"{message.cycle_time} ms" if message.cycle_time else "control step")
        assert message.dbc is not None
        assert message.dbc.attributes["DataId"].value == int(data_id, 16)


def test_signals_are_the_dbc_s() -> None:
    rows = rows_of("reference/wire.md", "frame", "signal")
    listed = [(plain(row[0]), plain(row[1])) for row in rows]
    signals = {(message.name, signal.name): signal for message in database().messages for signal in message.signals}
    assert len(listed) == len(set(listed))
    assert set(listed) == set(signals)
    for frame, name, bits, step, span, meaning in rows:
        signal = signals[plain(frame), plain(name)]
        last = f"..{signal.start + signal.length - 1}" if signal.length > 1 else ""
        unit = f" {signal.unit}" if signal.unit else ""
        assert bits == f"{signal.start}{last}"
        assert step == f"{signal.scale:g}{unit}"
        assert span == f"0..{signal.maximum:.10g}{unit}"
        numbered = dict(re.findall(r"(\d) ([a-z]+(?: range)?)", meaning))
        if signal.choices and numbered:
            words = {str(k): str(v).lower().replace("range", " range") for k, v in signal.choices.items()}
            assert numbered.items() <= words.items(), meaning


def test_golden_vectors_in_the_document_are_those_of_the_file() -> None:
    rows = [
        (int(row[0], 16), plain(row[1]), row[3])
        for row in rows_of("reference/firmware.md", "identifier", "bytes", "carries")
    ]
    assert rows == [(golden["id"], golden["data"], golden["about"]) for golden in GOLDEN["frame"]]
    for row, golden in zip(
        rows_of("reference/firmware.md", "identifier", "bytes", "carries"), GOLDEN["frame"], strict=True
    ):
        told = dict(part.split() for part in row[2].split(", "))
        assert {name: float(int(v, 16) if v.startswith("0x") else float(v)) for name, v in told.items()} == {
            name: pytest.approx(value) for name, value in golden["values"].items()
        }


def test_refused_vectors_in_the_document_are_those_of_the_file() -> None:
    rows = [
        (int(r[0], 16), plain(r[1]), r[2], r[3]) for r in rows_of("reference/firmware.md", "identifier", "bytes", "why")
    ]
    assert rows == [(golden["id"], golden["data"], golden["why"], golden["about"]) for golden in GOLDEN["refused"]]


@pytest.mark.parametrize("golden", GOLDEN["refused"], ids=lambda golden: golden["about"])
def test_refused_vectors_are_refused_by_both_twins_and_for_that_reason(golden: dict[str, Any]) -> None:
    data, spec = bytes.fromhex(golden["data"]), contract().frames["PumpCommand"]
    frame = Message(arbitration_id=golden["id"], data=data, is_extended_id=False)
    check = FrameCheck(spec, counter=0, accepted_ns=1)
    assert check.admit(frame, 2) is Rejection(golden["why"])
    parsed = parse_command(frame)
    node_s: object = parsed
    if golden["why"] in ("duplicate", "old"):
        assert not isinstance(parsed, NodeRejection)
        node_s = PumpNode._check_counter(_after_counter_zero(), parsed.counter, 2)
    assert node_s is NodeRejection(golden["why"])


def _after_counter_zero() -> PumpNode:
    from tests.doctor.doctor_bench import LockstepBench

    bench = LockstepBench()
    bench.pump._last = (0, 1)
    bench.close()
    return bench.pump


def test_the_crc_by_bits_is_the_document_s() -> None:
    """The pseudo code, taken at its word."""
    text = (DOCS / "reference/firmware.md").read_text()
    assert "(crc << 1) xor 0x2F if its top bit is set" in text

    def crc(data: bytes) -> int:
        register = 0xFF
        for byte in data:
            register ^= byte
            for _ in range(8):
                register = (register << 1 ^ (0x2F if register & 0x80 else 0)) & 0xFF
        return register ^ 0xFF

    data_ids = {int(row[1], 16): int(row[5], 16) for row in rows_of("reference/wire.md", "frame", "identifier")}
    for golden in GOLDEN["frame"]:
        *body, last = bytes.fromhex(golden["data"])
        whole = data_ids[golden["id"]].to_bytes(2, "little") + bytes(body)
        assert crc(whole) == last == Crc8Autosar.calc(whole)


def test_every_conformance_test_is_explained_in_its_order(monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.doctor.nodes_bench import tried

    explained = [name for row in rows_of("reference/firmware.md", "test") for name in re.findall(r"`([^`]+)`", row[0])]
    results, _ = tried(monkeypatch, PumpNode, with_pumps=True, level_node=True)
    assert len(explained) == len(set(explained))
    assert set(explained) == {*results, suite.POWER_CYCLE}
    names = [name for name, _ in (*suite.COMMANDS, *suite.TRIPS, *suite.WITH_PUMPS)]
    assert [name for name in explained if name in names] == names


def test_times_are_the_code_s() -> None:
    by_frame = {
        "`LowerLevels`, `UpperLevels`": "LowerLevels",
        "`PumpStatus`": "PumpStatus",
        "heartbeats, from power-up on": "PumpHeartbeat",
    }
    rows = {row[0]: row for row in rows_of("reference/firmware.md", "what")}
    for what, name in by_frame.items():
        cycle_ms = contract().frames[name].cycle_s * 1e3
        assert rows[what][1:] == (
            f"every {cycle_ms:g} ms",
            f"{suite.PERIOD_TOLERANCE:.0%} in the mean".replace("%", " %"),
        )
    assert rows["watchdog"][1] == f"{check_watchdog.WATCHDOG_S * 1e3:g} ms after the last accepted command"
    assert rows["watchdog"][2] == f"{check_watchdog.TOLERANCE_S * 1e3:g} ms"
    assert COUNTER_STEP_MAX == MAX_COUNTER_STEP == 8


@lru_cache
def text_of(page: Path) -> str:
    """The text of a page; one that is made from the code is made here, as it is not in version control."""
    is_made = page.parent == FOLDER and page.name in PAGES
    return PAGES[page.name]() if is_made else page.read_text()


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.relative_to(DOCS).as_posix())
def test_links_between_the_documents_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if file.parent == FOLDER and file.name in PAGES:
            continue  # made from the code; tests/docs/test_site.py has the links to these
        assert file.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", text_of(file), re.MULTILINE)
            assert anchor in [re.sub(r"[^\w\s-]", "", heading.lower()).replace(" ", "-") for heading in headings], (
                target
            )


def test_every_check_of_the_doctor_is_explained_once() -> None:
    from tests.doctor.doctor_bench import LockstepBench
    from tests.doctor.test_doctor_host import GOOD

    explained = [name for row in rows_of("how-to/operating.md", "check") for name in re.findall(r"`([^`]+)`", row[0])]
    made = set(examined(LockstepBench(), with_pumps=True)) | {result.check for result in check_host.check_host(GOOD)}
    made |= {result.check for result in check_link(None, "can0", 500_000, is_socketcan=False)} | {check_lines({}).check}
    assert len(explained) == len(set(explained))
    assert set(explained) == made | {"bus opens", "pumps", "examination"}


def test_limits_of_the_doctor_are_the_code_s() -> None:
    text = " ".join((DOCS / "how-to/operating.md").read_text().split())
    assert (
        f"within {check_frames.PERIOD_WARN:.0%}; warns beyond, "
        f"or of a jitter above {check_frames.JITTER_WARN:.0%}".replace("%", " %")
        in text
    )
    assert (
        f"off by more than {check_frames.PERIOD_FAIL:.0%}, or fewer than {check_frames.MIN_FRAMES} came".replace(
            "%", " %"
        )
        in text
    )
    assert f"| {check_frames.LOSS_FAIL:.0%} or more |".replace("%", " %") in text
    assert f"{check_sensors.QUIET_WARN:g} to {check_sensors.NOISE_WARN:g} times" in text
    assert f"above {check_sensors.NOISE_FAIL:g} times" in text
    assert f"below {check_sensors.LOW_SHARE:.0%} of the range".replace("%", " %") in text
    assert f"after the last command, within {check_watchdog.TOLERANCE_S * 1e3:g} ms" in text
    assert f"PumpStatus' period and {check_echo.MARGIN_S * 1e3:g} ms" in text
    assert f"{check_ramp.RESPONSE_LOW:g} to {check_ramp.RESPONSE_HIGH:g} times what rig.toml says" in text
    assert f"less than {check_ramp.NO_RESPONSE:g} times" in text
    assert f"gives each pump {check_ramp.TOP_V:g} V for {check_ramp.HOLD_S:g} s" in text
    assert f"{check_host.MIN_LOCKED_BYTES / 2**20:g} MiB or more" in text
    assert f"less than {check_host.DISK_FAIL_BYTES / 2**20:g} MiB" in text
    assert check_host.DISK_WARN_BYTES == 2**30


def test_the_checks_named_in_advice_exist() -> None:
    """The doctor sends people to these documents; they are there."""
    from tests.doctor.doctor_bench import LockstepBench

    results = examined(LockstepBench(overlay={"nodes": {"watchdog_s": 0.5}}))
    assert "docs/reference/firmware.md" in results["watchdog"].advice
