"""Page of the kinds of faults that the emulator plays, from its catalogue."""

from __future__ import annotations

from firmware_sim.faults.catalogue import as_markdown


def fault_kinds_page() -> str:
    """The whole page."""
    return (
        "# Fault kinds\n\nEvery kind of fault that the emulator plays, from the classes in `firmware_sim/faults`. "
        "[Faults](faults.md) explains how they act together, and the `failure` command.\n\n" + as_markdown()
    )
