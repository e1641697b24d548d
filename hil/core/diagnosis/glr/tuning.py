"""The tuning of the diagnosis, with what each number trades."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Tuning:
    """Thresholds, priors and times.

    Detection.
    detect : log-likelihood ratio that raises an alarm. settle_s : no alarm in this time after the first readings.

    Isolation.
    margin : by how much the likeliest hypothesis must lead.
    drift_margin : by how much a drift of a lower tank's sensor must lead a leak or blockage of that tank.
    both_lead : a single pump is not declared while both pumps together lead it by this.
    second_pump_std : a single pump is declared only when the other's gain is known to this standard deviation.
    min_steps : steps after the onset before a verdict, because the first step has only part of the fault in it.
    min_drift_steps : the same for a sensor drift, which a few noisy readings resemble.
    jump_margin : a sensor bias that leads by this needs no min_steps, nothing else is so quick.
    resolve_within_s : after this time the likeliest hypothesis is taken without the margin.
    overtaken, min_fit_steps : a misfit at which something else must have happened since the fault; the likeliest
    hypothesis is then taken without the margin if it had explained the readings for min_fit_steps.
    drop_margin : a hypothesis this far behind the likeliest is not replayed any further.
    replay_budget : filter steps of the replays in one control period; the rest waits for the next period.

    Filter.
    parameter_std : how far gains, splits and outlets may be off the rig file's, relative. lag_std : the same for lags.
    parameter_walk : standard deviation of their change in a control period.
    min_level_walk : least standard deviation of the levels' random walk, cm/sqrt(s); what it is is learned.
    reading_floor_V : smallest standard deviation of a mean of readings: converters have steps.
    scale_pace : how fast the assumed noise follows innovations that are larger than expected. calm : it follows only
    while the likelihood ratio is below this; the noise of the process likewise, but for the first first_learning_s.

    A rig that its file does not describe, see `first_day`.
    wide_gain_std, wide_outlet_std, wide_lag_std : how far gains, outlets and lags may be off then, relative.
    passing_std : how far what an upper tank lets out may be off what arrives below, as a share. zone_std_V,
    bend_std_1_V : how far a pump's dead zone and the bend of its curve may be off.
    relearn_from_s, relearn_until_s, relearn_keep : in this time after the start, at each doubling of it, this share of
    what was learned is kept.

    After the verdict.
    size_doubt, prior_doubt : how wrong an isolated size may be for reasons that its variance does not include, as
    shares of itself and of its prior.
    sharpen_s : a second verdict on a fault within this time updates the first.
    rival_s : for this time after a sensor drift is declared, a leak or blockage may still reverse the verdict.
    stuck_check_s : for this time a pump whose gain has changed is checked for being stuck at some flow.
    readmit_s : a lost sensor that agrees with the filter for this time is used again.
    diverged, diverged_s : mean square of the whitened innovations, over this time, that no fault explains.
    verdicts_max : as many verdicts within diverged_s also mean divergence.
    """

    detect: float = 20.0
    margin: float = 5.0
    drift_margin: float = 6.0
    both_lead: float = 3.0
    second_pump_std: float = 0.04
    min_steps: int = 2
    min_drift_steps: int = 8
    jump_margin: float = 50.0
    resolve_within_s: float = 18.0
    overtaken: float = 40.0
    min_fit_steps: int = 10
    settle_s: float = 1.0

    parameter_std: float = 0.03
    lag_std: float = 0.5
    parameter_walk: float = 2e-5
    min_level_walk: float = 6.3e-4
    reading_floor_V: float = 5e-4
    scale_pace: float = 0.003
    calm: float = 8.0
    first_learning_s: float = 10.0

    size_doubt: float = 0.1
    prior_doubt: float = 0.05
    drop_margin: float = 50.0
    sharpen_s: float = 3.0
    rival_s: float = 150.0
    replay_budget: int = 600
    stuck_check_s: float = 10.0
    readmit_s: float = 5.0
    diverged: float = 6.0
    diverged_s: float = 10.0
    verdicts_max: int = 6

    wide_gain_std: float = 0.2
    wide_outlet_std: float = 0.07
    wide_lag_std: float = 1.5
    passing_std: float = 0.02
    zone_std_V: float = 0.25
    bend_std_1_V: float = 0.015
    relearn_from_s: float = 2.0
    relearn_until_s: float = 100.0
    relearn_keep: float = 0.3
