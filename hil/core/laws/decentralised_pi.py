"""Decentralised PI control: one PI controller for each output, each on a pump of its own.

K. H. Johansson, The quadruple-tank process, IEEE Trans. Control Systems Technology 8(3), 2000:

    v_j = v0_j + K_i (e_i + 1/T_i integral of e_i),      e_i = r_i - y_i

Pairing by the relative gain of the process (E. H. Bristol, IEEE Trans. Automatic Control 11(1), 1966):
lambda = gamma1 gamma2 / (gamma1 + gamma2 - 1). At or above 1/2, output i gets pump i; below it, the other pump.

Ours: back-calculation against windup with the time constant T_i, bumpless transfer, and on request drives divided by
the pumps' effectiveness.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.control_law import Authority, LawInputs, LawRequest
from hil.core.laws.law_plant import LawPlant, SteadyAim, change_events, known_effectiveness, pump_drives, steady_aim
from hil.core.tanks import TankModel
from hil.core.types import Pair


def relative_gain(model: TankModel) -> float:
    """lambda, entry (1, 1) of the relative gain array: how much of output 1 pump 1 keeps while the other loop works."""
    g1, g2 = model.valve_split
    return g1 * g2 / (g1 + g2 - 1.0)


def is_crossed(model: TankModel) -> bool:
    """Whether the relative gain asks for pump 2 on output 1 and pump 1 on output 2."""
    return relative_gain(model) < 0.5


@dataclass(frozen=True, slots=True)
class PiMemory:
    """bias_V, integral_V : (2,) v0 and integral part of each pump, effective drives in V."""

    bias_V: Pair
    integral_V: Pair
    aim: SteadyAim
    aim_for: tuple[Pair, Pair]


@dataclass(frozen=True, slots=True)
class DecentralisedPi:
    """gain_V_V, integral_s : (2,) K_i and T_i of each output. crossed : whether output i has the other pump.

    use_diagnosis : whether drives are divided by the diagnosed effectiveness of the pumps.
    """

    plant: LawPlant
    gain_V_V: Pair
    integral_s: Pair
    crossed: bool = False
    use_diagnosis: bool = False

    def start(self, inputs: LawInputs) -> PiMemory:
        """From pumps at rest with the drives that hold the first reference; otherwise from those that they have."""
        theta = known_effectiveness(inputs.followed, self.use_diagnosis)
        aim = steady_aim(self.plant, inputs.reference_V, theta)
        memory = PiMemory(aim.effective_V, (0.0, 0.0), aim, (inputs.reference_V, theta))
        return memory if inputs.given_V == (0.0, 0.0) else self._taken_over(memory, inputs)

    def step(self, memory: PiMemory, inputs: LawInputs) -> tuple[PiMemory, LawRequest]:
        """One step of both controllers. An error of this step counts from the next one on."""
        before, memory = memory, self._following(memory, inputs)
        if inputs.authority is Authority.OPERATOR:
            memory = self._taken_over(memory, inputs)
        (p1, p2), (i1, i2), (b1, b2) = self._proportional(inputs), memory.integral_V, memory.bias_V
        drive_V = pump_drives(memory.aim, (b1 + p1 + i1, b2 + p2 + i2))
        events = change_events(before.aim, memory.aim) if self.use_diagnosis else ()
        shown = {"integral_1_V": i1, "integral_2_V": i2}
        return memory, LawRequest(drive_V=drive_V, target_V=inputs.reference_V, shown=shown, events=events)

    def _following(self, memory: PiMemory, inputs: LawInputs) -> PiMemory:
        """The memory after the last period: integrals of error and of what the pumps were not given."""
        theta = known_effectiveness(inputs.followed, self.use_diagnosis)
        aim = memory.aim
        if memory.aim_for != (inputs.reference_V, theta):
            aim = steady_aim(self.plant, inputs.reference_V, theta)
        gains, times = self._of_pumps(self.gain_V_V), self._of_pumps(self.integral_s)
        errors = self._of_pumps(_errors(self.plant.model, inputs))
        i1, i2 = (
            value + inputs.period_s / time * (gain * error - share * excess)
            for value, time, gain, error, share, excess in zip(
                memory.integral_V,
                times,
                gains,
                errors,
                memory.aim.effectiveness,
                inputs.excess_V,
                strict=True,
            )
        )
        return PiMemory(memory.bias_V, (i1, i2), aim, (inputs.reference_V, theta))

    def _taken_over(self, memory: PiMemory, inputs: LawInputs) -> PiMemory:
        """The memory from which this law gives the drives that the pumps have."""
        (p1, p2), (b1, b2), (t1, t2) = self._proportional(inputs), memory.bias_V, memory.aim.effectiveness
        integral_V = (t1 * inputs.given_V[0] - b1 - p1, t2 * inputs.given_V[1] - b2 - p2)
        return PiMemory(memory.bias_V, integral_V, memory.aim, memory.aim_for)

    def _proportional(self, inputs: LawInputs) -> Pair:
        e1, e2 = _errors(self.plant.model, inputs)
        return self._of_pumps((self.gain_V_V[0] * e1, self.gain_V_V[1] * e2))

    def _of_pumps(self, of_outputs: Pair) -> Pair:
        """Values of the outputs in the order of their pumps."""
        return (of_outputs[1], of_outputs[0]) if self.crossed else of_outputs


def _errors(model: TankModel, inputs: LawInputs) -> Pair:
    """(2,) e = r - y in V."""
    k = model.level_gain_V_cm
    return inputs.reference_V[0] - k * inputs.level_cm[0], inputs.reference_V[1] - k * inputs.level_cm[1]
