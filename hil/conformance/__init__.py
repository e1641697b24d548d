"""Whether a real node does what docs/firmware.md asks of it: the tests that the emulator passes, over the bus."""
