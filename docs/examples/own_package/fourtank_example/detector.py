"""A fault detector that integrates the level filter's innovations into the pumps' effectiveness."""

from math import isfinite

import hil


class InnovationDetector:
    """Pump j feeds lower tank j: where the level stays below its prediction, the pump moves less than it should."""

    def __init__(self, rate_1_Vs: float) -> None:
        self._rate_1_Vs = rate_1_Vs

    def start(self):
        """The effectiveness of both pumps is all that is remembered."""
        return (1.0, 1.0)

    def step(self, memory, t_s, measurement, estimate, applied_V):
        """One control step at run time t_s."""
        innovations = [value if isfinite(value) else 0.0 for value in estimate.innovation_V[:2]]
        theta = tuple(
            min(max(before + self._rate_1_Vs * innovation, 0.1), 1.0)
            for before, innovation in zip(memory, innovations, strict=True)
        )
        alarms = tuple(
            hil.Alarm(t_s, "pump_effectiveness", pump + 1, theta[pump], isolated_s=t_s, number=pump + 1)
            for pump in (0, 1)
            if theta[pump] < 0.9 <= memory[pump]
        )
        return theta, hil.Diagnosis(theta, alarms)


def make_detector(rig, scenario):
    """The bench calls this with the settings of the rig file and of the scenario."""
    return InnovationDetector(rate_1_Vs=20.0 * rig.control.period_s)
