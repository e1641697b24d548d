"""Two PI controllers as a control law of the bench, with settings of their own."""

from typing import Annotated

from pydantic import Field

import hil


class TwoPiOptions(hil.LawOptions):
    """What `[control.options]` of a scenario may say."""

    gain: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0
    integral_s: Annotated[float, Field(gt=0.0, le=1000.0)] = 20.0


class TwoPi:
    """v = gain e + integral part for each output, e = r - y, on the pump of the same number."""

    def __init__(self, setup: hil.LawSetup, options: TwoPiOptions) -> None:
        self._setup, self._options = setup, options

    def start(self, inputs):
        """The integral parts are all that is remembered."""
        return self._setup.operating_drives if inputs.given_V == (0.0, 0.0) else inputs.given_V

    def step(self, memory, inputs):
        """One control step."""
        gain, share = self._options.gain, inputs.period_s / self._options.integral_s
        outputs = [self._setup.model.level_gain_V_cm * level_cm for level_cm in inputs.level_cm[:2]]
        parts = [gain * (r - y) for r, y in zip(inputs.reference_V, outputs, strict=True)]
        if inputs.authority is hil.Authority.LAW:
            memory = [m + share * (p - x) for m, p, x in zip(memory, parts, inputs.excess_V, strict=True)]
        elif inputs.authority is hil.Authority.OPERATOR:
            memory = [drive - p for drive, p in zip(inputs.given_V, parts, strict=True)]
        drives = tuple(m + p for m, p in zip(memory, parts, strict=True))
        return tuple(memory), hil.LawRequest(drives, inputs.reference_V, shown={"integral_1_V": memory[0]})


def make_law(setup: hil.LawSetup, options: TwoPiOptions):
    """The bench calls this with the settings of rig and scenario, and the checked options."""
    return TwoPi(setup, options)
