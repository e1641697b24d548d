"""A control law of your own: two PI controllers, one for each output, each on the pump of the same number."""

from dataclasses import dataclass

import hil

Pair = tuple[float, float]


@dataclass(frozen=True)
class TwoPi:
    """v = gain e + integral part, with e = r - y, for each output. From pumps at rest it begins with operating_V."""

    level_gain_V_cm: float
    operating_V: Pair
    gain: float = 5.0
    integral_s: float = 20.0

    def start(self, inputs: hil.LawInputs) -> Pair:
        """The integral parts are all that is remembered."""
        return self.operating_V if inputs.given_V == (0.0, 0.0) else inputs.given_V

    def step(self, memory: Pair, inputs: hil.LawInputs) -> tuple[Pair, hil.LawRequest]:
        """One control step."""
        integrals, drives = [], []
        for pump in (0, 1):
            error_V = inputs.reference_V[pump] - self.level_gain_V_cm * inputs.level_cm[pump]
            part, share = memory[pump], inputs.period_s / self.integral_s
            if inputs.authority is hil.Authority.LAW:  # what the pumps were not given must not wind up
                part += share * (self.gain * error_V - inputs.excess_V[pump])
            elif inputs.authority is hil.Authority.OPERATOR:  # so that the return from MANUAL has no jump
                part = inputs.given_V[pump] - self.gain * error_V
            integrals.append(part)
            drives.append(part + self.gain * error_V)
        request = hil.LawRequest(
            drive_V=(drives[0], drives[1]),
            target_V=inputs.reference_V,
            shown={"integral_1_V": integrals[0], "integral_2_V": integrals[1]},
        )
        return (integrals[0], integrals[1]), request


if __name__ == "__main__":
    rig = hil.load("steps").rig
    two_pi = TwoPi(rig.tank_model.level_gain_V_cm, rig.operating_drives)
    for name, law in (("state feedback", "state_feedback"), ("two PI controllers", two_pi)):
        result = hil.simulate("steps", law=law, duration_s=200.0)
        errors = ", ".join(f"{value:.2f}" for value in (result.series["iae1_Vs"][-1], result.series["iae2_Vs"][-1]))
        print(f"{name}: {result.status}, IAE {errors} V s over 200 s")
