"""Fault diagnosis by generalised likelihood ratios: detect, isolate, size, again and again.

model              states and prediction: levels, pump lag, slow parameters, fault sizes
filter             one step of the extended Kalman filter; its innovations are white as long as nothing has failed
hypotheses         what can go wrong, each a jump of one state of that filter
bank               every hypothesis at every onset of the last minute, linear: raises the alarm
refilter           the filter again from the onset, once per hypothesis: tells them apart and says how large
isolation          from an alarm to a verdict; `declaration` names it, `drift_review` and `stuck_check` may change it
ambiguity          what cannot be told apart yet
hidden_level       how full a lower tank is by a drift of its sensor that is not excluded
growth             the rate of a fault that grows
sensor_statistics  what single readings show without a model: stuck, open, noisy sensors; `sensor_monitor` acts on it
rollback           back to an earlier step, and the readings since filtered again
memory             what all of these share, and carry from step to step
glr_detector       composes the above into a `FaultDetector`
compiled, kernels  how the inner loops are compiled by numba, when the detector is built, and called

Willsky and Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear systems",
IEEE Trans. Automatic Control 21(1), 1976. Why this method: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`.
"""
