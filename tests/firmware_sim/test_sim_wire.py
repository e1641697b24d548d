"""The hand-written packing against golden bytes and against the DBC; CRC; command checks; fingerprint."""

import zlib
from itertools import combinations
from pathlib import Path
from typing import Any

import cantools
import pytest
from can import Message
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim import frames
from firmware_sim.frames import (
    COMMAND_ID,
    LEVEL_HEARTBEAT_ID,
    LOWER_LEVELS_ID,
    PUMP_HEARTBEAT_ID,
    STATUS_ID,
    UPPER_LEVELS_ID,
    ChannelStatus,
    NodeState,
    PumpCommand,
    Rejection,
    TripCause,
    counter_verdict,
    parse_command,
)
from firmware_sim.settings import load_fingerprint
from tests.firmware_sim.sim_bench import CONFIG, GOLDEN, command_bytes, frame_of


@pytest.fixture(scope="module")
def database() -> Database:
    loaded = cantools.database.load_file(CONFIG / "bench.dbc", cache_dir=None)
    assert isinstance(loaded, Database)
    return loaded


def packed(can_id: int, values: dict[str, Any]) -> bytes:
    """The bytes that the emulator makes of a golden frame's values."""
    if can_id == COMMAND_ID:
        return command_bytes(
            values["Command1"],
            values["Command2"],
            enable=bool(values["Enable"]),
            clear=bool(values["ClearTrip"]),
            starts=bool(values["StartPhase"]),
            counter=values["Counter"],
        )
    if can_id == STATUS_ID:
        return frames.pack_status(
            (values["Applied1"], values["Applied2"]),
            NodeState(values["State"]),
            TripCause(values["TripCause"]),
            values["Echo"],
            values["Counter"],
            values["Accepted"],
        )
    if can_id in (LOWER_LEVELS_ID, UPPER_LEVELS_ID):
        first, second = ("1", "2") if can_id == LOWER_LEVELS_ID else ("3", "4")
        return frames.pack_levels(
            can_id,
            (values["Level" + first], values["Level" + second]),
            (ChannelStatus(values["Status" + first]), ChannelStatus(values["Status" + second])),
            values["Counter"],
        )
    return frames.pack_heartbeat(
        can_id, NodeState(values["State"]), values["Counter"], values["BootCount"], values["Contract"]
    )


def decoded(database: Database, can_id: int, data: bytes) -> dict[str, Any]:
    values = database.decode_message(can_id, data, decode_choices=False)
    assert isinstance(values, dict)
    assert values.pop("Crc") == frames.crc8(can_id, data[:-1])
    return values


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden["about"])
def test_golden_values_pack_to_golden_bytes(golden: dict[str, Any]) -> None:
    assert packed(golden["id"], golden["values"]).hex(" ") == golden["data"]


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden["about"])
def test_golden_bytes_carry_golden_values_by_the_dbc(database: Database, golden: dict[str, Any]) -> None:
    values = decoded(database, golden["id"], bytes.fromhex(golden["data"]))
    assert values == pytest.approx(golden["values"], abs=1e-9)


@pytest.mark.parametrize(
    "golden", [golden for golden in GOLDEN if golden["id"] == COMMAND_ID], ids=lambda g: g["about"]
)
def test_golden_commands_are_parsed(golden: dict[str, Any]) -> None:
    values = golden["values"]
    assert parse_command(frame_of(bytes.fromhex(golden["data"]))) == PumpCommand(
        (values["Command1"], values["Command2"]),
        bool(values["Enable"]),
        bool(values["ClearTrip"]),
        values["Counter"],
        bool(values["StartPhase"]),
    )


VOLTS = st.sampled_from([0, 1, 49_999, 50_000]).map(lambda raw: raw / 5000)
LEVELS = st.sampled_from([0, 1, 51_199, 51_200]).map(lambda raw: raw / 5000)
NIBBLE = st.sampled_from([0, 1, 7, 8, 15])
STATES, STATUSES = st.sampled_from(NodeState), st.sampled_from(ChannelStatus)


@given(VOLTS, VOLTS, STATES, st.sampled_from(TripCause), NIBBLE, NIBBLE, st.sampled_from([0, 1, 255]))
def test_status_at_its_limits_matches_the_dbc(
    database: Database, v1: float, v2: float, state: NodeState, cause: TripCause, echo: int, counter: int, accepted: int
) -> None:
    data = frames.pack_status((v1, v2), state, cause, echo, counter, accepted)
    expected = {
        "Applied1": v1,
        "Applied2": v2,
        "State": state,
        "TripCause": cause,
        "Echo": echo,
        "Counter": counter,
        "Accepted": accepted,
    }
    assert decoded(database, STATUS_ID, data) == pytest.approx(expected)
    assert database.encode_message(STATUS_ID, expected | {"Crc": data[-1]}) == data


@given(st.sampled_from([LOWER_LEVELS_ID, UPPER_LEVELS_ID]), LEVELS, LEVELS, STATUSES, STATUSES, NIBBLE)
def test_levels_at_their_limits_match_the_dbc(
    database: Database, can_id: int, va: float, vb: float, sa: ChannelStatus, sb: ChannelStatus, counter: int
) -> None:
    a, b = ("1", "2") if can_id == LOWER_LEVELS_ID else ("3", "4")
    data = frames.pack_levels(can_id, (va, vb), (sa, sb), counter)
    expected = {"Level" + a: va, "Level" + b: vb, "Status" + a: sa, "Status" + b: sb, "Counter": counter}
    assert decoded(database, can_id, data) == pytest.approx(expected)
    assert database.encode_message(can_id, expected | {"Crc": data[-1]}) == data


@given(
    st.sampled_from([PUMP_HEARTBEAT_ID, LEVEL_HEARTBEAT_ID]),
    STATES,
    NIBBLE,
    st.sampled_from([0, 1, 65_535]),
    st.sampled_from([0, 1, 2**32 - 1]),
)
def test_heartbeats_at_their_limits_match_the_dbc(
    database: Database, can_id: int, state: NodeState, counter: int, boots: int, contract: int
) -> None:
    data = frames.pack_heartbeat(can_id, state, counter, boots, contract)
    expected = {"State": state, "Counter": counter, "BootCount": boots, "Contract": contract}
    assert decoded(database, can_id, data) == expected
    assert database.encode_message(can_id, expected | {"Crc": data[-1]}) == data


@given(VOLTS, VOLTS, st.booleans(), st.booleans(), st.booleans(), NIBBLE)
def test_commands_encoded_by_the_dbc_are_parsed(
    database: Database, v1: float, v2: float, enable: bool, clear: bool, starts: bool, counter: int
) -> None:
    flags = {"Enable": enable, "ClearTrip": clear, "StartPhase": starts}
    values = {"Command1": v1, "Command2": v2, **flags, "Counter": counter}
    data = database.encode_message(COMMAND_ID, values | {"Crc": 0})
    data = frames.sealed(COMMAND_ID, data[:-1])
    parsed = parse_command(frame_of(data))
    assert isinstance(parsed, PumpCommand)
    assert parsed.command_V == pytest.approx((v1, v2))
    assert parsed == PumpCommand(parsed.command_V, enable, clear, counter, starts)


def test_ids_data_ids_and_lengths_are_those_of_the_dbc(database: Database) -> None:
    in_dbc = {message.frame_id: message for message in database.messages}
    assert in_dbc.keys() == frames.DATA_IDS.keys()
    for can_id, message in in_dbc.items():
        assert message.dbc is not None
        assert message.dbc.attributes["DataId"].value == frames.DATA_IDS[can_id]
        assert not message.is_extended_frame
    assert in_dbc[COMMAND_ID].length == frames.COMMAND_LENGTH


def test_crc_check_value_of_the_polynomial() -> None:
    """The check value of CRC-8/AUTOSAR over the digits 1 to 9 is 0xDF."""
    assert frames._crc_over(0xFF, b"123456789") ^ 0xFF == 0xDF


@pytest.mark.parametrize("flips", [1, 2])
@pytest.mark.parametrize("data", [command_bytes(3.0, 4.0, counter=1), command_bytes(enable=False, clear=True)])
def test_every_flip_of_one_or_two_bits_is_rejected(data: bytes, flips: int) -> None:
    whole = int.from_bytes(data, "little")
    for bits in combinations(range(8 * len(data)), flips):
        broken = whole
        for bit in bits:
            broken ^= 1 << bit
        assert parse_command(frame_of(broken.to_bytes(len(data), "little"))) is Rejection.CRC


GOOD = command_bytes(3.0, 4.0)


@pytest.mark.parametrize(
    ("frame", "cause"),
    [
        (frame_of(GOOD, is_extended_id=True), Rejection.EXTENDED),
        (frame_of(GOOD, is_fd=True), Rejection.FD),
        (frame_of(GOOD, is_error_frame=True), Rejection.ERROR),
        (Message(arbitration_id=COMMAND_ID, is_extended_id=False, is_remote_frame=True, dlc=6), Rejection.REMOTE),
        (frame_of(GOOD, can_id=STATUS_ID), Rejection.FOREIGN),
        (frame_of(b"", can_id=0), Rejection.FOREIGN),
        *[(frame_of(GOOD[:length]), Rejection.LENGTH) for length in range(6)],
        (frame_of(GOOD + b"\0"), Rejection.LENGTH),
        (frame_of(GOOD[:3], dlc=6), Rejection.LENGTH),
        (frame_of(GOOD[:5] + bytes([GOOD[5] ^ 1])), Rejection.CRC),
        (frame_of(frames.sealed(STATUS_ID, GOOD[:5])), Rejection.CRC),
        (frame_of(command_bytes(10.0002, 0.0)), Rejection.RANGE),
        (frame_of(command_bytes(0.0, 13.107)), Rejection.RANGE),
    ],
)
def test_what_is_not_a_good_command_is_rejected(frame: Message, cause: frames.Rejection) -> None:
    assert parse_command(frame) is cause


def test_spare_bits_are_ignored() -> None:
    payload = bytearray(GOOD[:5])
    payload[4] |= 0b1000
    assert parse_command(frame_of(frames.sealed(COMMAND_ID, bytes(payload)))) == parse_command(frame_of(GOOD))


@pytest.mark.parametrize("last", range(16))
@pytest.mark.parametrize("step", range(16))
def test_counter_rule(last: int, step: int) -> None:
    expected = Rejection.DUPLICATE if step == 0 else step - 1 if step <= 8 else Rejection.OLD
    assert counter_verdict((last + step) % 16, last) == expected


def test_fingerprint_ignores_trailing_white_space_and_line_ends(tmp_path: Path) -> None:
    text = (CONFIG / "bench.dbc").read_text()
    expected = zlib.crc32("\n".join(line.rstrip() for line in text.splitlines()).encode())
    assert load_fingerprint(CONFIG / "bench.dbc") == expected
    other = tmp_path / "bench.dbc"
    other.write_bytes(text.replace("\n", " \t\r\n").encode())
    assert load_fingerprint(other) == expected
    other.write_text(text.replace("500 kbit/s", "250 kbit/s"))
    assert load_fingerprint(other) != expected


def test_the_emulator_does_not_import_the_controller_or_cantools() -> None:
    """The modules in the folders below firmware_sim used to be left out."""
    modules = list((CONFIG.parent / "firmware_sim").rglob("*.py"))
    assert {module.parent.name for module in modules} == {"firmware_sim", "faults", "fmu"}
    for module in modules:
        source = module.read_text()
        assert "import hil" not in source
        assert "from hil" not in source
        assert "cantools" not in source
