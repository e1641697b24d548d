"""Recorded runs as data: tables of frames, signals, control steps and events."""
