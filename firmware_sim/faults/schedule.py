"""When faults act.

Faults of a scenario wait for its start (t = 0, when the pump node first enters run); injected faults begin at once.

Of two faults that set the same value, the later onset wins; when that fault ends, the earlier one applies again. Of two
that begin at the same time, the later one in the list wins.
"""

from collections.abc import Callable

from firmware_sim.faults.base import Fault
from firmware_sim.faults.effects import Effects
from firmware_sim.faults.episode import Episode


class FaultSchedule:
    """Runs faults on the emulator's clock. `seed` fixes what is random about them."""

    def __init__(self, faults: tuple[Fault, ...], seed: int = 0) -> None:
        self._waiting = faults
        self._seed = seed
        self._count = 0
        self._entries: list[tuple[Episode, Fault]] = []
        self._next_ns: int | None = None
        self.effects = Effects()

    @property
    def next_ns(self) -> int | None:
        """When a fault next begins, changes or ends, or None."""
        return self._next_ns

    def start(self, now_ns: int) -> None:
        """Make now the moment t = 0 of the scenario."""
        waiting, self._waiting = self._waiting, ()
        for fault in waiting:
            self._add(fault, now_ns)
        self._plan(now_ns - 1)

    def inject(self, fault: Fault, now_ns: int) -> None:
        """Let a fault begin now; its times count from now."""
        self._add(fault, now_ns)
        self._plan(now_ns - 1)

    def end(self, is_meant: Callable[[Fault], bool], now_ns: int) -> int:
        """End the active faults that are meant, and return how many there were."""
        ended = [episode for episode, fault in self._entries if episode.is_active(now_ns) and is_meant(fault)]
        for episode in ended:
            episode.end_ns = now_ns
        self._plan(now_ns - 1)
        return len(ended)

    def active(self, now_ns: int) -> tuple[Fault, ...]:
        """The faults that are there now, in order of their onsets."""
        return tuple(fault for episode, fault in self._entries if episode.is_present(now_ns))

    def advance(self, now_ns: int) -> None:
        """Bring `effects` to the faults that are active now."""
        if not self._entries:
            return
        self._plan(now_ns)
        self.effects = Effects()
        for episode, fault in self._entries:
            if episode.advance(now_ns):
                fault.apply(self.effects, episode)

    def _add(self, fault: Fault, origin_ns: int) -> None:
        episode = Episode(self._seed, self._count, origin_ns, fault)
        self._count += 1
        self._entries.append((episode, fault))
        self._entries.sort(key=lambda entry: entry[0].onset_ns)

    def _plan(self, after_ns: int) -> None:
        times_ns = (episode.next_change_ns(after_ns) for episode, _ in self._entries)
        self._next_ns = min((time_ns for time_ns in times_ns if time_ns is not None), default=None)
