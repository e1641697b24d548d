"""Coverage-guided fuzzing of the readers of external bytes: `python -m tools.fuzz TARGET --seconds N`.

The fuzzer is atheris (libFuzzer), which has wheels for Linux on x86-64. A target takes any bytes and checks the
properties that must hold for all of them; tests check the same targets with hypothesis.
"""
