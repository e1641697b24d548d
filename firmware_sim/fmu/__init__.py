"""The emulator's plant as a co-simulation unit (FMU) of the Functional Mock-up Interface, version 2.0."""
