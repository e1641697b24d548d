"""Checks if a bench is ready for a run; pure checks of a probe's observations. See docs/decisions/0016-doctor.md."""
