"""Logs for tests: lines as candump writes them, and a DBC with every kind of signal."""

from __future__ import annotations

import random
from functools import cache

import cantools
from cantools.database.can import Database

KINDS_DBC = """
VERSION ""

BU_: A B

BO_ 256 Kinds: 8 A
 SG_ UnsignedIntel : 0|12@1+ (0.1,-40) [0|0] "degC" B
 SG_ SignedIntel : 12|9@1- (1,0) [0|0] "" B
 SG_ SignedMotorola : 28|11@0- (0.25,3) [0|0] "bar" B
 SG_ WholeScale : 40|8@1+ (3,-7) [0|0] "" B
 SG_ OddMotorola : 53|11@0+ (1,0) [0|0] "" B

BO_ 257 Wide: 8 A
 SG_ Unsigned64 : 0|64@1+ (1,0) [0|0] "" B

BO_ 258 WideMotorola: 8 A
 SG_ Signed64 : 7|64@0- (1,0) [0|0] "" B

BO_ 259 Floats: 8 A
 SG_ Intel : 0|32@1- (1,0) [0|0] "m" B
 SG_ Motorola : 39|32@0- (2,1) [0|0] "m" B

BO_ 2147483904 Extended: 3 A
 SG_ Mode : 0|4@1+ (1,0) [0|0] "" B
 SG_ Named : 4|4@1- (2,1) [0|0] "" B

BO_ 260 Multiplexed: 4 A
 SG_ Selector M : 0|1@1+ (1,0) [0|0] "" B
 SG_ First m0 : 8|8@1+ (1,0) [0|0] "V" B
 SG_ Second m1 : 8|16@1- (0.5,0) [0|0] "A" B
 SG_ Always : 24|8@1+ (1,0) [0|0] "" B

SIG_VALTYPE_ 259 Intel : 1;
SIG_VALTYPE_ 259 Motorola : 1;
VAL_ 2147483904 Mode 0 "Off" 1 "On" ;
VAL_ 2147483904 Named -1 "None" 3 "Three" ;
"""


@cache
def kinds_database() -> Database:
    """Signals of both byte orders, signed, floating, whole, named, multiplexed, in extended frames."""
    database = cantools.database.load_string(KINDS_DBC, "dbc")
    assert isinstance(database, Database)
    return database


def random_log(database: Database, frames: int, seed: int) -> bytes:
    """Frames of the database with random payloads, as text."""
    draw = random.Random(seed)  # noqa: S311
    lines = []
    for number in range(frames):
        message = draw.choice(database.messages)
        name = f"{message.frame_id:08X}" if message.is_extended_frame else f"{message.frame_id:03X}"
        lines.append(f"({1.7e9 + 0.001237 * number:.6f}) can0 {name}#{draw.randbytes(message.length).hex().upper()}\n")
    return "".join(lines).encode()
