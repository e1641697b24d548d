"""The whole rig: tanks, pump node, level node and faults. The caller gives the time, in whole nanoseconds.

Time starts at 0 with the power-up of both nodes. Every event has its own due time; events of equal times come in this
order: nodes' own events (end of boot, watchdog), faults, level frames, status, heartbeats. Turbulence acts together
with the level frames. A frame from outside at exactly the time of an event comes after it.
Results depend neither on the steps in which `advance` is called nor on calls of `truth`.
"""

from can import Message

from firmware_sim.faults import NS_PER_S, Fault, FaultSchedule
from firmware_sim.faulty_wire import FOREIGN, FaultyWire
from firmware_sim.frames import (
    COMMAND_ID,
    LEVEL_HEARTBEAT_ID,
    LOWER_LEVELS_ID,
    PUMP_HEARTBEAT_ID,
    STATUS_ID,
    UPPER_LEVELS_ID,
    Frame,
    NodeState,
    Rejection,
)
from firmware_sim.level_node import LevelNode, Quad
from firmware_sim.parameter_spread import Turbulence, drawn
from firmware_sim.pump_node import Change, Observer, PumpNode
from firmware_sim.pump_path import PumpPaths
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings
from firmware_sim.tanks import Tanks
from firmware_sim.truth import Truth

__all__ = ["Rig", "Truth"]

NEVER_NS = 1 << 63
NS_PER_H = 3600 * NS_PER_S


def _ignore(change: Change) -> None:
    del change


class Rig:
    """The emulated rig. `seed` decides all random numbers; `fingerprint` is the contract's CRC-32.

    parameters : the settings with the parameters that this seed has drawn.
    """

    def __init__(
        self,
        settings: EmulatorSettings,
        faults: tuple[Fault, ...],
        seed: int,
        fingerprint: int,
        observer: Observer | None = None,
    ) -> None:
        observe = observer or _ignore
        self.parameters = settings = drawn(settings, seed)
        self.pump = PumpNode(settings, fingerprint, observe)
        self.level = LevelNode(settings, seed, fingerprint, observe)
        self._tanks = Tanks(settings)
        self._paths = PumpPaths(settings, seed)
        self._faults = FaultSchedule(faults, seed)
        self._effectiveness = self._faults.effects.effectiveness
        self._turbulence = Turbulence(settings, seed) if any(parts(settings.tanks.turbulence_cm3_sqrt_s, 4)) else None
        self._is_ageing = self._turbulence is not None or any(parts(settings.pumps.wear_per_h, 2))
        self._levels_period_ns = round(settings.nodes.levels_period_s * NS_PER_S)
        self._status_period_ns = round(settings.nodes.status_period_s * NS_PER_S)
        self._heartbeat_period_ns = round(settings.nodes.heartbeat_period_s * NS_PER_S)
        self._levels_ns = self._status_ns = self._heartbeat_ns = 0
        self._now_ns = 0
        self._tanks_ns = 0
        self._is_held = settings.tanks.hold_until_run
        self._start_ns: int | None = None
        self._output_V = self.pump.applied_V
        self._outbox: list[Message] = []
        self._wire = FaultyWire(self._queue, self._give_to_pump, lambda: self.pump.next_counter)
        self._put = self._send
        self._answer: Rejection | None = None
        self._rebooted_ns = {"pump": -1, "level": -1}
        self._rare_ns = self._next_rare_ns()

    @property
    def now_ns(self) -> int:
        """Time to which the rig has advanced."""
        return self._now_ns

    @property
    def start_ns(self) -> int | None:
        """The time of the scenario's t = 0, or None."""
        return self._start_ns

    @property
    def next_event_ns(self) -> int:
        """Due time of the next event."""
        return min(self._levels_ns, self._status_ns, self._heartbeat_ns, self._rare_ns)

    def advance(self, to_ns: int) -> list[Message]:
        """Carry out all events up to and including to_ns.

        Returns the frames that were sent since the last call, each with its own time in seconds. Raises
        ValueError if to_ns lies in the past.
        """
        self._catch_up(to_ns)
        sent, self._outbox = self._outbox, []
        return sent

    def receive(self, frame: Message, now_ns: int) -> Rejection | None:
        """Take a frame from the bus at now_ns; None if the pump node accepted it now, as a command.

        Raises ValueError if now_ns lies in the past.
        """
        self._catch_up(now_ns)
        if not self._wire.is_active:
            return self._give_to_pump(frame, now_ns)
        self._answer = Rejection.LOST
        self._wire.carry(frame.arbitration_id if frame.arbitration_id == COMMAND_ID else FOREIGN, frame, now_ns)
        self._rare_ns = self._next_rare_ns()
        return self._answer

    def inject(self, fault: Fault, now_ns: int) -> None:
        """Let a fault begin now; its own times count from now. Raises ValueError if now_ns lies in the past."""
        self._catch_up(now_ns)
        self._faults.inject(fault, now_ns)
        self._run_rare_events(now_ns)

    def recover(self, kinds: set[str], targets: set[int | str] | None, now_ns: int) -> int:
        """End the active faults of these kinds and targets (None: any); return their number.

        Raises ValueError if now_ns lies in the past.
        """
        self._catch_up(now_ns)
        count = self._faults.end(
            lambda fault: fault.kind in kinds and (targets is None or fault.target in targets), now_ns
        )
        self._run_rare_events(now_ns)
        return count

    def power_off(self, now_ns: int) -> None:
        """Put the outputs at 0 V, even if now_ns lies in the past."""
        now_ns = max(now_ns, self._now_ns)
        self.pump.power_off(now_ns)
        self.level.power_off(now_ns)
        self._follow_pump(now_ns)
        self._rare_ns = self._next_rare_ns()

    @property
    def levels_cm(self) -> Quad:
        """True levels at `now_ns`."""
        return self._tanks_now().levels_cm

    @property
    def effectiveness(self) -> tuple[float, float]:
        """Share of the flow of a pump as new that each pump gives."""
        e1, e2 = self._effectiveness
        return e1, e2

    def truth(self) -> Truth:
        """Return the state of the rig at `now_ns`."""
        tanks = self._tanks_now()
        start_ns = self._start_ns
        return Truth(
            t_s=self._now_ns / NS_PER_S,
            scenario_s=None if start_ns is None else (self._now_ns - start_ns) / NS_PER_S,
            levels_cm=tanks.levels_cm,
            applied_V=self.pump.applied_V,
            effectiveness=self.effectiveness,
            spilled_cm3=tanks.spilled_cm3,
            pump_state=self.pump.state,
            faults=tuple(f"{fault.kind} {fault.target}" for fault in self._faults.active(self._now_ns)),
        )

    def _tanks_now(self) -> Tanks:
        """The tanks at `now_ns`; a copy if they have to be advanced, so that a query changes nothing."""
        if self._is_held or self._tanks_ns == self._now_ns:
            return self._tanks
        tanks = self._tanks.copy()
        dt_s = (self._now_ns - self._tanks_ns) / NS_PER_S
        tanks.advance(dt_s, self._paths.flow_V, self._paths.effectiveness)
        return tanks

    def _catch_up(self, to_ns: int) -> None:
        if to_ns < self._now_ns:
            raise ValueError(f"time {to_ns} ns is before {self._now_ns} ns, to which the rig has advanced")
        while (due_ns := self.next_event_ns) <= to_ns:
            self._now_ns = due_ns
            self._run_events(due_ns)
        self._now_ns = to_ns

    def _run_events(self, now_ns: int) -> None:
        if self._rare_ns <= now_ns:
            self._run_rare_events(now_ns)
        if self._levels_ns <= now_ns:
            self._levels_ns += self._levels_period_ns
            self._send_levels(now_ns)
        if self._status_ns <= now_ns:
            self._status_ns += self._status_period_ns
            self._put(STATUS_ID, self.pump.status(), now_ns)
        if self._heartbeat_ns <= now_ns:
            self._heartbeat_ns += self._heartbeat_period_ns
            self._put(PUMP_HEARTBEAT_ID, self.pump.heartbeat(), now_ns)
            self._put(LEVEL_HEARTBEAT_ID, self.level.heartbeat(), now_ns)

    def _run_rare_events(self, now_ns: int) -> None:
        self.pump.run_event(now_ns)
        self.level.run_event(now_ns)
        self._follow_pump(now_ns)
        fault_ns = self._faults.next_ns
        if fault_ns is not None and fault_ns <= now_ns:
            self._advance_tanks(now_ns)
            self._faults.advance(now_ns)
            self._apply_effects(now_ns)
        arrival_ns = self._paths.next_ns
        if arrival_ns is not None and arrival_ns <= now_ns:
            self._advance_tanks(now_ns)
            if self._paths.advance(now_ns):
                self._tanks.set_valve_split(self._paths.splits)
        self._wire.run_due(now_ns)
        self._rare_ns = self._next_rare_ns()

    def _next_rare_ns(self) -> int:
        """Due time of the next change of a node's state, of a fault or at a valve; NEVER_NS if there is none."""
        next_ns = NEVER_NS
        nodes = self.pump.next_event_ns, self.level.next_event_ns
        for due_ns in (*nodes, self._faults.next_ns, self._paths.next_ns, self._wire.next_ns):
            if due_ns is not None and due_ns < next_ns:
                next_ns = due_ns
        return next_ns

    def _follow_pump(self, now_ns: int) -> None:
        """Apply the pump node's outputs to the pumps, and start the scenario.

        Its time 0 is when the node first runs; after a start phase, when it runs on a command without that flag.
        """
        if self._start_ns is None and self.pump.state is NodeState.RUN:
            self._advance_tanks(now_ns)
            self._is_held = False
            if not self.pump.is_start_phase:
                self._start_ns = now_ns
                self._faults.start(now_ns)
        if self.pump.applied_V != self._output_V:
            self._advance_tanks(now_ns)
            self._output_V = self.pump.applied_V
            self._drive_pumps(now_ns)

    def _drive_pumps(self, now_ns: int) -> None:
        """Apply the pump node's outputs to the pumps, except to pumps that are stuck on, and their effectiveness.

        The tanks have advanced to now.
        """
        (v1, v2), (stuck1, stuck2) = self._output_V, self._faults.effects.stuck_on_V
        voltage_V = (v1 if stuck1 is None else stuck1, v2 if stuck2 is None else stuck2)
        if self._paths.give(voltage_V, self._effectiveness, now_ns):
            self._tanks.set_valve_split(self._paths.splits)

    def _apply_effects(self, now_ns: int) -> None:
        """Apply a changed set of faults to plant and nodes; the tanks have advanced to the time of the change."""
        effects = self._faults.effects
        self._tanks.apply_effects(effects)
        self._set_effectiveness(now_ns)
        self.level.channel_faults = effects.channels
        self._wire.apply_effects(effects, now_ns)
        self._put = self._send_through_faults if self._wire.is_active else self._send
        for name, node in (("pump", self.pump), ("level", self.level)):
            node.wall_ahead_ns = effects.wall_ahead_ns.get(name, 0)
            lost_ns, back_ns = effects.reboots.get(name, (-1, -1))
            if lost_ns > self._rebooted_ns[name]:
                self._rebooted_ns[name] = lost_ns
                node.reboot(now_ns, back_ns)
        self._follow_pump(now_ns)

    def _set_effectiveness(self, now_ns: int) -> None:
        """Set the pumps' effectiveness now, to which the tanks have advanced, and drive them."""
        run_h = 0.0 if self._start_ns is None else (now_ns - self._start_ns) / NS_PER_H
        self._effectiveness = self._paths.effectiveness_after(run_h, self._faults.effects)
        self._drive_pumps(now_ns)

    def _apply_ageing(self, now_ns: int) -> None:
        """Apply turbulence and wear of one level period."""
        if self._is_held:
            return
        self._set_effectiveness(now_ns)
        if self._turbulence is not None:
            self._tanks.stir(self._turbulence.volumes_cm3())

    def _advance_tanks(self, now_ns: int) -> None:
        if not self._is_held:
            dt_s = (now_ns - self._tanks_ns) / NS_PER_S
            self._tanks.advance(dt_s, self._paths.flow_V, self._paths.effectiveness)
        self._tanks_ns = now_ns

    def _send_levels(self, now_ns: int) -> None:
        if self._is_ageing:
            self._advance_tanks(now_ns)
            self._apply_ageing(now_ns)
        if self.level.state is NodeState.RUN:
            self._advance_tanks(now_ns)
            lower, upper = self.level.levels(self._tanks.levels_cm, now_ns)
            self._put(LOWER_LEVELS_ID, lower, now_ns)
            self._put(UPPER_LEVELS_ID, upper, now_ns)

    def _give_to_pump(self, frame: Message, now_ns: int) -> Rejection | None:
        """Give a frame to the pump node and return its answer."""
        self._answer = rejection = self.pump.receive(frame, now_ns)
        if rejection is None:
            self._follow_pump(now_ns)
            self._rare_ns = self._next_rare_ns()
        return rejection

    def _queue(self, frame: Message) -> None:
        self._outbox.append(frame)

    def _send_through_faults(self, can_id: int, payload: bytes, now_ns: int) -> None:
        frame = Frame(now_ns / NS_PER_S, can_id, is_extended_id=False, data=payload, is_rx=False)
        self._wire.carry(can_id, frame, now_ns)
        self._rare_ns = self._next_rare_ns()  # a delayed frame may be the next event

    def _send(self, can_id: int, payload: bytes, now_ns: int) -> None:
        self._outbox.append(Frame(now_ns / NS_PER_S, can_id, is_extended_id=False, data=payload, is_rx=False))
