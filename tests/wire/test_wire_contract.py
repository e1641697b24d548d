"""The contract: layouts against cantools and golden bytes, CRC, which DBCs are refused and why."""

import math
import re
import zlib
from typing import Any

import cantools
import pytest
from cantools.database.can import Database
from crccheck.crc import Crc8Autosar
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.types import Command
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract, ContractError, FrameSpec, crc8, fingerprint
from tests.narrowing import not_none
from tests.wire.wire_bench import CONTRACT, DATABASE, DBC, DEFAULTS, GOLDEN, NAMES, go, payload_of, sealed


def spec_of(can_id: int) -> FrameSpec:
    return next(spec for spec in CONTRACT.frames.values() if spec.frame_id == can_id)


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden["about"])
def test_golden_bytes_decode_to_golden_values(golden: dict[str, Any]) -> None:
    data = bytes.fromhex(golden["data"])
    values = spec_of(golden["id"]).decode(data)
    assert values is not None
    assert values.pop("Crc") == data[-1]
    assert values == pytest.approx(golden["values"], abs=1e-9)


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden["about"])
def test_golden_values_encode_to_golden_bytes(golden: dict[str, Any]) -> None:
    assert spec_of(golden["id"]).encode(golden["values"]).hex(" ") == golden["data"]


@pytest.mark.parametrize("golden", [g for g in GOLDEN if g["id"] == 0x201], ids=lambda golden: golden["about"])
def test_sender_writes_the_golden_commands(golden: dict[str, Any]) -> None:
    values = golden["values"]
    sender = CommandSender(CONTRACT)
    assert sender.frame_id == golden["id"]
    for _ in range(values["Counter"]):
        sender.encode(Command((0.0, 0.0), enable=False), 0)
    flags = [bool(values[name]) for name in ("Enable", "ClearTrip", "StartPhase")]
    command = Command((values["Command1"], values["Command2"]), *flags)
    assert sender.encode(command, 0).hex(" ") == golden["data"]


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=60, deadline=None)
@given(st.binary(min_size=8, max_size=8))
def test_decoding_agrees_with_cantools(name: str, noise: bytes) -> None:
    spec, theirs = CONTRACT.frames[name], DATABASE.get_message_by_name(name)
    data = noise[: spec.length]
    expected: Any = theirs.decode(data, decode_choices=False)
    in_range = all(not_none(s.minimum) <= expected[s.name] <= not_none(s.maximum) + 1e-9 for s in theirs.signals)
    values = spec.decode(data)
    assert (values is not None) == in_range
    if values is not None:
        assert values == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_in_range_values_come_back_from_the_wire(name: str, data: st.DataObject) -> None:
    signals = [s for s in DATABASE.get_message_by_name(name).signals if s.name != "Crc"]
    values = {
        s.name: data.draw(st.integers(0, round(not_none(s.maximum) / not_none(s.scale)))) * float(s.scale)
        for s in signals
    }
    payload = CONTRACT.frames[name].encode(values)
    decoded = CONTRACT.frames[name].decode(payload)
    assert decoded is not None
    assert decoded.pop("Crc") == payload[-1]
    assert decoded == pytest.approx(values, rel=1e-12)
    assert payload == sealed(name, DATABASE.encode_message(name, values | {"Crc": 0}, strict=False)[:-1])


@pytest.mark.parametrize("name", NAMES)
def test_one_step_beyond_a_signals_range_is_refused_both_ways(name: str) -> None:
    spec, theirs = CONTRACT.frames[name], DATABASE.get_message_by_name(name)
    refused = 0
    for signal in theirs.signals:
        assert signal.maximum is not None
        assert signal.scale is not None
        highest, scale = round(signal.maximum / signal.scale), float(signal.scale)
        if signal.name == "Crc":
            continue
        values = DEFAULTS[name] | {"Counter": 3, signal.name: highest * scale}
        assert spec.decode(spec.encode(values)) is not None
        with pytest.raises(ValueError, match=re.escape(f" is outside 0..{highest * scale:g}")):
            spec.encode(values | {signal.name: (highest + 1) * scale})
        with pytest.raises(ValueError, match="outside"):
            spec.encode(values | {signal.name: -scale})
        if highest + 1 < 2**signal.length:
            assert spec.decode(payload_of(name, 0, **(values | {signal.name: (highest + 1) * scale}))) is None
            refused += 1
    assert refused


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0), st.booleans(), st.integers(0, 40))
def test_commands_come_back_from_the_wire_with_their_counter(v1: float, v2: float, enable: bool, before: int) -> None:
    sender = CommandSender(CONTRACT)
    for _ in range(before):
        sender.encode(go(), 0)
    values: Any = DATABASE.decode_message("PumpCommand", sender.encode(go(v1, v2, enable=enable), 0))
    assert (values["Command1"], values["Command2"]) == pytest.approx((v1, v2), abs=1.01e-4)
    assert values["Enable"] == enable
    assert values["ClearTrip"] == 0
    assert values["Counter"] == before % 16


@pytest.mark.parametrize("volts", [math.nan, math.inf, -math.inf, -0.0002, 10.0002, 1e9])
def test_a_command_that_is_no_voltage_of_a_pump_is_never_put_on_the_wire(volts: float) -> None:
    sender = CommandSender(CONTRACT)
    for command in (go(volts, 1.0), go(1.0, volts)):
        with pytest.raises((ValueError, OverflowError)):
            sender.encode(command, 0)
    assert sender.sent == 0
    assert sender.unechoed_s(10**9) == 0.0
    decoded: Any = DATABASE.decode_message("PumpCommand", sender.encode(go(), 0))
    assert decoded["Counter"] == 0


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=64))
def test_crc_is_that_of_autosar(data: bytes) -> None:
    assert crc8(data) == Crc8Autosar.calc(data)
    assert crc8(bytearray(data)) == crc8(data)


def test_crc_check_value() -> None:
    assert crc8(b"123456789") == 0xDF


def test_contract_has_the_frames_and_identifiers_of_the_dbc() -> None:
    assert set(CONTRACT.ids) == {m.frame_id for m in DATABASE.messages}
    for name, spec in CONTRACT.frames.items():
        assert (spec.name, spec.frame_id, spec.length) == (
            name,
            DATABASE.get_message_by_name(name).frame_id,
            DATABASE.get_message_by_name(name).length,
        )


def test_fingerprint_is_blind_to_line_endings_and_nothing_else() -> None:
    expected = zlib.crc32("\n".join(line.rstrip() for line in DBC.splitlines()).encode())
    assert fingerprint(DBC) == CONTRACT.fingerprint == expected
    assert fingerprint(DBC.replace("\n", "\r\n")) == expected
    assert fingerprint(DBC.replace("\n", " \t\n")) == expected
    assert fingerprint(DBC.rstrip("\n")) == expected
    assert fingerprint(DBC.replace("500 kbit/s", "250 kbit/s")) != expected
    assert fingerprint(DBC.replace("\n", "\n ")) != expected


def without(pattern: str) -> str:
    changed, count = re.subn(pattern, "", DBC, flags=re.MULTILINE)
    assert count
    return changed


def with_change(old: str, new: str) -> str:
    assert old in DBC
    return DBC.replace(old, new)


def without_frame(can_id: int) -> str:
    text = without(rf"^BO_ {can_id} .*\n( SG_ .*\n)+")
    return re.sub(rf"^(CM_ (BO|SG)_|VAL_|BA_ .* BO_) {can_id} .*\n", "", text, flags=re.MULTILINE)


@pytest.mark.parametrize("name", NAMES)
def test_a_dbc_without_one_of_the_frames_is_refused(name: str) -> None:
    with pytest.raises(ContractError, match=f"^has no frame {name}$"):
        Contract.from_dbc(without_frame(CONTRACT.frames[name].frame_id))


@pytest.mark.parametrize(("name", "signal"), [(m.name, s.name) for m in DATABASE.messages for s in m.signals])
def test_a_dbc_without_one_of_the_signals_is_refused(name: str, signal: str) -> None:
    lines, renamed, inside = [], 0, False
    for line in DBC.splitlines():
        inside = line.startswith(f"BO_ {CONTRACT.frames[name].frame_id} ") or (inside and line.startswith(" SG_ "))
        if inside and f" SG_ {signal} " in line:
            line, renamed = line.replace(signal, "Other", 1), renamed + 1
        if not re.match(rf"(CM_ SG_|VAL_) \d+ {signal} ", line):
            lines.append(line)
    assert renamed == 1
    with pytest.raises(ContractError, match=f"^frame {name} has no signal {signal}$"):
        Contract.from_dbc("\n".join(lines))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not a DBC: "),
        ("tanks = 4\n", "is not a DBC: "),
        ("{}", "is not a DBC: "),
        ("\0\xff", "is not a DBC: "),
        (DBC[: len(DBC) // 2], "is not a DBC: "),
        (with_change("BO_ 642", "BO_ 386"), "is not a DBC: "),
        (with_change("513", str(513 + 2**31)), "frame PumpCommand must have an 11-bit id"),
        (with_change("PumpCommand: 6", "PumpCommand: 7"), "frame PumpCommand must have an 11-bit id and its Crc in"),
        (
            with_change("Counter : 40|4@1+ (1,0) [0|15]", "Counter : 48|4@1+ (1,0) [0|15]").replace(
                "Crc : 48|8", "Crc : 40|8"
            ),
            "frame LowerLevels must have an 11-bit id and its Crc in the last byte",
        ),
        (with_change("Crc : 40|8@1+", "Crc : 40|7@1+"), "frame PumpCommand must have an 11-bit id and its Crc in"),
        (with_change('BA_ "DataId" BO_ 385 10625;', ""), "frame PumpStatus has no attribute DataId"),
        (with_change("BO_ 385 10625", "BO_ 385 70000"), "frame PumpStatus has DataId 70000, must be 0..65535"),
        (with_change("BO_ 385 10625", "BO_ 385 -1"), "frame PumpStatus has DataId -1, must be 0..65535"),
        (with_change("Level1 : 0|16@1+", "Level1 : 7|16@0+"), "signal Level1 of LowerLevels must be little-endian"),
        (with_change("Level1 : 0|16@1+", "Level1 : 0|16@1-"), "signal Level1 of LowerLevels must be little-endian, un"),
        (with_change("Level3 : 0|16@1+ (0.0002,0)", "Level3 : 0|16@1+ (0.0002,1)"), "must be little-endian, unsigned"),
        (with_change("Applied1 : 0|16@1+ (0.0002,0) [0|", "Applied1 : 0|16@1+ (0.0002,0) [1|"), "must start at 0"),
        (with_change("Applied1 : 0|16@1+ (0.0002,0)", "Applied1 : 0|16@1+ (0,0)"), "must have a scale above 0"),
        (with_change("Applied1 : 0|16@1+ (0.0002,0)", "Applied1 : 0|16@1+ (-1,0)"), "must have a scale above 0"),
        (with_change("State : 0|4@1+", "State :-8|4@1+"), "signal State of PumpHeartbeat must start at bit 0 or later"),
        (with_change("Echo : 40|4@1+ (1,0) [0|15]", "Echo : 40|3@1+ (1,0) [0|7]"), "signal Echo of PumpStatus must "),
        (with_change("State : 32|4@1+ (1,0) [0|3]", "State : 32|4@1+ (1,0) [0|15]"), "must count 0..3"),
        (with_change("Counter : 36|4@1+ (1,0)", "Counter : 36|4@1+ (2,0)"), "must count 0..15"),
        (
            with_change("Crc : 40|8@1+ (1,0) [0|255]", "Crc : 40|8@1+ (1,0) [0|25]"),
            "signal Crc of PumpCommand must count",
        ),
    ],
)
def test_a_wrong_dbc_is_refused_with_the_reason(text: str, reason: str) -> None:
    with pytest.raises(ContractError) as refusal:
        Contract.from_dbc(text)
    assert reason in str(refusal.value)
    assert "\n" not in str(refusal.value)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, DBC.index("CM_ ")), st.integers(1, 12), st.sampled_from(["", "0", "-1", "7", "x", " ", "@"]))
def test_a_damaged_dbc_is_refused_in_one_line_or_understood_as_cantools_does(
    position: int, length: int, patch: str
) -> None:
    """That nothing else was raised used to be all that was asserted."""
    text = DBC[:position] + patch + DBC[position + length :]
    try:
        contract = Contract.from_dbc(text)
    except ContractError:
        with pytest.raises(ContractError, match=r"^[^\n]*\S[^\n]*$"):
            Contract.from_dbc(text)
        return
    assert set(contract.frames) == set(NAMES)
    database = cantools.database.load_string(text, database_format="dbc")
    assert isinstance(database, Database)
    for name, spec in contract.frames.items():
        described = database.get_message_by_name(name)
        assert (spec.frame_id, spec.length) == (described.frame_id, described.length)
        for data in (bytes(spec.length), bytes(range(1, spec.length + 1)), b"\x55" * spec.length):
            values = spec.decode(data)
            if values is None:
                continue
            theirs = described.decode(data, decode_choices=False)
            assert isinstance(theirs, dict)
            assert values == pytest.approx({signal: theirs[signal] for signal in values})
            sealed_again = spec.encode(values)
            assert sealed_again[-1] == crc8(sealed_again[:-1], spec.crc_start)
            assert {k: v for k, v in (spec.decode(sealed_again) or {}).items() if k != "Crc"} == pytest.approx(
                {k: v for k, v in values.items() if k != "Crc"}
            )


def test_the_dbc_as_it_is_passes_what_a_damaged_one_has_to() -> None:
    """Otherwise the comparison with cantools might never be reached."""
    assert all(spec.decode(bytes(spec.length)) is not None for spec in CONTRACT.frames.values())


def test_a_signal_too_many_is_spare_bits() -> None:
    """It used to make every command impossible to encode, the one for 0 V included."""
    extra = with_change(" SG_ Counter : 36|4@1+", ' SG_ Spare : 35|1@1+ (1,0) [0|1] "" PUMPS\n SG_ Counter : 36|4@1+')
    contract = Contract.from_dbc(extra)
    assert CommandSender(contract).encode(go(), 0) == CommandSender(CONTRACT).encode(go(), 0)


def test_a_range_of_nothing_is_the_whole_width() -> None:
    contract = Contract.from_dbc(
        with_change("Level1 : 0|16@1+ (0.0002,0) [0|10.24]", "Level1 : 0|16@1+ (0.0002,0) [0|0]")
    )
    values = contract.frames["LowerLevels"].decode(b"\xff\xff" + bytes(5))
    assert values is not None
    assert values["Level1"] == pytest.approx(13.107)
