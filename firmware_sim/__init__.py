"""Emulator of the four-tank rig: tanks, pump node and level node behind a CAN bus."""
