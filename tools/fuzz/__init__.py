"""Coverage-guided fuzzing of what reads bytes that others write: `python -m tools.fuzz TARGET --seconds N`.

The fuzzer is atheris (libFuzzer), which has wheels for Linux on x86-64. A target takes any bytes and asserts what must
hold of any; tests hold the same targets to what hypothesis comes up with.
"""
