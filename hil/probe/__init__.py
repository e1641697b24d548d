"""Shared by `hil doctor` and `hil conformance`: listening to a bus, sending single commands, results of checks.

See docs/decisions/0016-doctor.md.
"""
