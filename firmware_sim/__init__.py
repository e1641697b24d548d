"""Emulator of the four-tank rig: tanks, pump node and level node behind a CAN bus."""

from firmware_sim.lean_start import keep_asammdf_out

keep_asammdf_out()
