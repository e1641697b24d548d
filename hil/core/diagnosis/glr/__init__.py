"""Fault diagnosis by generalised likelihood ratios: detect, isolate, size, again and again.

process     one filter for levels, pump lag, slow parameters and fault sizes; its innovations are white when all is well
hypotheses  what can go wrong, each a jump of one state of that filter
bank        every hypothesis at every onset of the last minute, linear: raises the alarm (Willsky and Jones, 1976)
replay      the filter again from the onset, once per hypothesis: tells them apart and says how large
channels    what single readings show without a model: stuck, open, noisy sensors
detector    composes the above into a `FaultDetector`

Willsky and Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear systems",
IEEE Trans. Automatic Control 21(1), 1976. Inner loops are compiled by numba, when the detector is built.
"""
