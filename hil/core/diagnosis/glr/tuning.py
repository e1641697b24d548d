"""The numbers that the diagnosis is tuned by, with what each of them trades."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Tuning:
    """Thresholds, priors and times.

    detect : log-likelihood ratio that raises an alarm. margin : by how much the likeliest hypothesis must lead.
    both_lead : both pumps include each single one; by how much they must lead for a single one not to be believed yet.
    second_pump_std : a single pump is believed once a loss of the other would be known as well as this.
    least_steps : steps after the onset before anything is settled, since the first holds part of the fault only; a bias
    that leads by jump_margin is too quick for anything else. least_drift_steps : the same for drifts, which a handful
    of noisy readings look like.
    resolve_within_s : after so long the likeliest is taken without the margin. settle_s : no alarm before.
    overtaken : misfit at which something else must have happened since; the likeliest is taken then, too, if it had
    explained the readings for least_fit_steps.

    parameter_std : how far gains, splits and outlets may be off the rig file's, relative. lag_std : lags, likewise.
    parameter_walk, level_walk_cm : what they may move by themselves in a control period (standard deviation).
    reading_floor_V : a mean of readings is never trusted to less: converters have steps. scale_pace : how fast the
    believed noise follows innovations that are larger than expected. calm : below this ratio it may.

    size_doubt, prior_doubt : how wrong an isolated size may be for reasons that its variance doesn't know, as shares
    of itself and of its prior.
    drop_margin : a hypothesis so far behind the likeliest is replayed no further. sharpen_s : a fault told again within
    so long is the same one, told better. replay_budget : filter steps of the replays in one control period; what is
    left waits for the next.
    rival_s : for so long after a sensor is given up for its drift, a leak or blockage may still turn out to explain it.
    probation_s : for so long a pump's loss is held against "stuck at some flow". readmit_s : a lost sensor that agrees
    with the model for so long is trusted again. diverged : mean square of the whitened innovations that nothing
    explains, over diverged_s; so many verdicts within that time (verdicts_max) explain nothing either.
    """

    detect: float = 20.0
    margin: float = 5.0
    both_lead: float = 3.0
    second_pump_std: float = 0.04
    least_steps: int = 2
    least_drift_steps: int = 8
    jump_margin: float = 50.0
    resolve_within_s: float = 18.0
    overtaken: float = 40.0
    least_fit_steps: int = 10
    settle_s: float = 1.0

    parameter_std: float = 0.03
    lag_std: float = 0.5
    parameter_walk: float = 2e-5
    level_walk_cm: float = 2e-4
    reading_floor_V: float = 5e-4
    scale_pace: float = 0.003
    calm: float = 8.0

    size_doubt: float = 0.1
    prior_doubt: float = 0.05
    drop_margin: float = 50.0
    sharpen_s: float = 3.0
    rival_s: float = 40.0
    replay_budget: int = 600
    probation_s: float = 10.0
    readmit_s: float = 5.0
    diverged: float = 6.0
    diverged_s: float = 10.0
    verdicts_max: int = 6
