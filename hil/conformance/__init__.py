"""Tests over the bus whether a real node meets docs/reference/firmware.md. The emulator passes the same tests."""
