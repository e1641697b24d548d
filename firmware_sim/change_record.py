"""Record of everything that changed at the nodes: one JSON line each, written through at once."""

import json
from pathlib import Path

from firmware_sim.faults import NS_PER_S
from firmware_sim.pump_node import Change


class ChangeRecord:
    """Writes changes to a new file. Raises FileExistsError rather than touch an old one, OSError otherwise."""

    def __init__(self, file: Path) -> None:
        self._stream = file.open("x", encoding="utf-8")

    def __call__(self, change: Change) -> None:
        """Write one change as a line: t_s, the node's own wall_s, node, state, applied_V, cause."""
        line = {
            "t_s": change.t_ns / NS_PER_S,
            "wall_s": (change.t_ns + change.wall_ahead_ns) / NS_PER_S,
            "node": change.node,
            "state": change.state.name.lower(),
            "applied_V": list(change.applied_V),
            "cause": change.cause,
        }
        self._stream.write(json.dumps(line) + "\n")
        self._stream.flush()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()
