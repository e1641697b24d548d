"""A fault detector of your own: it integrates the level filter's innovations into the pumps' effectiveness."""

from dataclasses import dataclass

import hil


@dataclass(frozen=True)
class InnovationDetector:
    """Pump j feeds lower tank j: where the level stays below its prediction, the pump moves less than its voltage says.

    The filter predicts with the effectiveness reported last, so that the innovation goes to zero as it becomes right.
    """

    rate_1_Vs: float = 2.0
    alarm_below: float = 0.9

    def start(self) -> tuple[float, float]:
        """The effectiveness of both pumps is all that is remembered."""
        return (1.0, 1.0)

    def step(
        self,
        memory: tuple[float, float],
        t_s: float,
        measurement: hil.Measurement,
        estimate: hil.Estimate,
        applied_V: tuple[float, float],
    ) -> tuple[tuple[float, float], hil.Diagnosis]:
        """One control step at run time t_s."""
        theta = []
        for before, innovation_V in zip(memory, estimate.innovation_V[:2], strict=True):
            change = self.rate_1_Vs * innovation_V if innovation_V == innovation_V else 0.0
            theta.append(min(max(before + change, 0.1), 1.0))
        alarms = tuple(
            hil.Alarm(t_s, "pump_effectiveness", pump + 1, theta[pump], isolated_s=t_s, number=pump + 1)
            for pump in (0, 1)
            if theta[pump] < self.alarm_below <= memory[pump]
        )
        effectiveness = (theta[0], theta[1])
        return effectiveness, hil.Diagnosis(effectiveness, alarms)


if __name__ == "__main__":
    result = hil.simulate("paper", detector=InnovationDetector())
    for alarm in result.alarms:
        print(f"{alarm.kind} {alarm.target} reported at {alarm.detected_s:.1f} s (the fault begins at 200 s)")
    before, after = (result.series["theta1"][result.series["t_s"] >= at_s][0] for at_s in (199.0, 260.0))
    print(f"effectiveness of pump 1: {before:.2f} before, {after:.2f} a minute after (0.40 was played)")
