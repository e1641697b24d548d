"""What the control law is told of the rig as the filter knows it."""

import pytest

from hil.core.diagnosis.glr import identified
from hil.core.diagnosis.glr.hypotheses import JUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Declared
from hil.core.diagnosis.glr.model import GAIN, LEAK, OUTLET, SCALE, SPLIT
from hil.core.types import Measurement
from tests.glr.glr_bench import DETECTOR, MODEL

READING = Measurement((6.0, 6.0, 1.0, 1.0), (True,) * 4, 0.0, 5)


def place(kind: str, target: int) -> int:
    return next(j for j, jump in enumerate(JUMPS) if jump.target == target and kind in (jump.rises, jump.falls))


def declared(kind: str, size: float, healthy: float = 1.0) -> Declared:
    return Declared(kind=kind, size=size, healthy=healthy, number=1, detected_s=1.0, declared_s=2.0)


def test_waterways_are_those_of_the_filter_once_an_outlet_or_a_leak_is_declared() -> None:
    """Healthy gains, so that the pumps' effectiveness, which is relative to them, does not count twice."""
    m = Memory.begin(DETECTOR.config, 0.0, READING, (3.0, 3.0))
    m.x[OUTLET : OUTLET + 4] = (0.6, 1.02, -0.01, 0.98)
    m.x[LEAK : LEAK + 2] = (0.2, -0.001)
    m.x[GAIN : GAIN + 2], m.x[SCALE : SCALE + 2] = (0.4, 1.03), (1.1, 1.0)
    m.x[SPLIT : SPLIT + 2] = (1.01, 2.0)
    assert identified.waterways(DETECTOR.config, m) is None
    m.declared[place("pump_effectiveness", 1)] = declared("pump_effectiveness", -0.57, 0.97)
    assert identified.waterways(DETECTOR.config, m) is None
    for kind, target in (("outlet_block", 1), ("leak", 1), ("leak", 3), ("outlet_block", 4)):
        m.declared[place(kind, target)] = declared(kind, -0.4)
        ways = identified.waterways(DETECTOR.config, m)
        assert ways is not None
        assert ways.outlet == (0.6, 1.02, 0.0, 0.98)
        assert ways.leak == (0.2, 0.0)
        assert ways.gain == pytest.approx((0.97 * 1.1, 1.03))
        assert ways.split == pytest.approx((1.01 * MODEL.valve_split[0], 1.0))
        del m.declared[place(kind, target)]
