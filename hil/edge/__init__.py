"""The border to the machine: clock, bus, settings, files. What is pure lives in `hil.core`."""
