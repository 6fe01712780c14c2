"""Put a firmware's records into the host's log and words: the topics of `docs/log.md`, and how the run went."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

import numpy as np

from controller.controller import Controller
from controller.rig import Joint, Rig
from deploy.buses.reading import Reading
from deploy.buses.servo_bus import Reply
from deploy.firmware.findings import finding, read_values
from deploy.firmware.reasons import PLAIN, Reason, Why, sentence, unsure_joints
from deploy.firmware.records import Block, Change, Cycle, End, Event, Found, Record, Shape, Started
from deploy.host_loop import Outcome
from deploy.logs.cycle_message import CycleStep, CycleWords
from deploy.period import Period, health_fields
from deploy.states import State
from deploy.torque import unsure_sentence

Write: TypeAlias = Callable[[str, float, Mapping[str, Any]], None]
"""Takes one message: topic, time since the start of the run [s], fields."""

_STATES: Final = tuple(State)
"""By their numbers, `sv_state`."""
_RELEASED, _UNSURE, _HELD = 1, 2, 3


def shape_of(rig: Rig, controller: Controller) -> Shape:
    """Return how many of each a record has.

    Args:
        rig: the rig
        controller: the controller
    """
    return Shape(len(rig.joints), len(rig.sensors), len(controller.inputs), len(controller.outputs))


class RecordLog:
    """Take the records of one run, in their order; write the host's messages, and keep how the run went.

    Args:
        rig: the rig
        controller: the controller
        label: what the bus is called
        write: takes the messages
    """

    def __init__(self, rig: Rig, controller: Controller, label: str, write: Write) -> None:
        self.outcome = Outcome()
        self.ended = False
        self.state = State.OFF
        self._rig = rig
        self._label = label
        self._write = write
        self._words = CycleWords(rig, controller)
        self._origin_us = 0
        self._values: dict[str, dict[str, int]] = {}
        self._first_error = ""
        self._told: int | None = None
        self._timed_out = False

    def hear(self, record: Record) -> None:
        """Take the next record.

        Args:
            record: of the run, from its `Started` to its `End`; a `Hello` says nothing of a run
        """
        if isinstance(record, Started):
            self._origin_us = record.t_us
        elif isinstance(record, Block):
            self._read(record)
        elif isinstance(record, Found):
            self._find(record)
        elif isinstance(record, Change):
            self._change(record)
        elif isinstance(record, Cycle):
            self._step(record)
        elif isinstance(record, Event):
            self._event(record)
        elif isinstance(record, End):
            self._end(record)

    def t(self, t_us: int) -> float:
        """Return a time since the start of the run [s].

        Args:
            t_us: since boot [us]
        """
        return 1e-6 * (t_us - self._origin_us)

    # inside

    def _read(self, block: Block) -> None:
        if block.joint >= len(self._rig.joints):
            return
        joint = self._rig.joints[block.joint]
        values = read_values(joint, block)
        if block.checked:
            self._values.setdefault(joint.name, {}).update(values)
            return
        told = health_fields(joint, values)
        self._write("/health", self.t(block.t_us), {"joint": joint.name, "id": joint.id, **told})

    def _find(self, record: Found) -> None:
        values = self._values.get(self._rig.joints[record.joint].name, {}) if self._of_joint(record.joint) else {}
        found = finding(record, self._rig, self._label, values)
        self.outcome.findings.append(found)
        if found.level == "error":
            self._first_error = self._first_error or found.text
        self._say("finding", f"{found.level}: {found.text}", record.t_us)

    def _change(self, record: Change) -> None:
        why = Why(record.reason, record.joint, record.a, record.b)
        if record.left >= len(_STATES) or record.entered >= len(_STATES):
            return
        left, entered = _STATES[record.left], _STATES[record.entered]
        self._tell(why, record.t_us)
        self._timed_out |= entered is State.STOPPING and why.reason == Reason.TIME
        self.outcome.touched |= entered in (State.ARMED, State.STOPPING)
        reason = self._sentence(why)
        names = {"left": left.value, "entered": entered.value, "reason": reason}
        self._say("state", f"{left.value} -> {entered.value}: {reason}", record.t_us, **names)
        self.state = entered

    def _tell(self, why: Why, t_us: int) -> None:
        """Tell of a fault or a wish before it changes the state; what the way out shows is told there."""
        if self.state is State.STOPPING or why.reason == self._told or not (why.faulty or why.stopped):
            return
        self._told = why.reason
        self._say("fault" if why.faulty else "stop", self._sentence(why), t_us)

    def _step(self, record: Cycle) -> None:
        rig, outcome = self._rig, self.outcome
        started = self.t(record.t_us)
        read = started + 1e-6 * record.read_us
        aimed = read + 1e-6 * record.compute_us
        ended = aimed + 1e-6 * max(record.write_us, 0)
        replies = {
            joint.id: Reply(joint.id, "missing" if record.missed >> number & 1 else "data", b"", 0, read)
            for number, joint in enumerate(rig.joints)
        }
        written = None if record.write_us < 0 else ended
        done = Period(1e-6 * record.late_us, started, read, aimed, ended, replies, written)
        njoint = len(rig.joints)
        ages = [math.inf if age < 0 else 1e-6 * age for age in record.ages_us]
        step = CycleStep(
            np.array(record.raw, np.int32),
            [*ages[:njoint], *ages[:njoint], *ages[:njoint], *ages[njoint:]],
            np.array(record.terminal_bits, np.uint32).view(np.float32),
            np.array(record.output_bits, np.uint32).view(np.float32),
            np.array(record.goals, np.int32),
        )
        self._write("/cycle", started, self._words.message(record.k, step, done, 0.0))
        outcome.cycles = record.k + 1
        outcome.pose = {
            sensor.name: (count - sensor.zero) * sensor.scale
            for sensor, count, age in zip(rig.sensors, record.raw[3 * njoint :], record.ages_us[njoint:], strict=True)
            if age >= 0
        }
        outcome.start_pose = outcome.start_pose or outcome.pose

    def _event(self, record: Event) -> None:
        if record.event == _HELD:
            self._say("torque", "every servo holds its last goal", record.t_us)
        elif record.event == _RELEASED:
            self._say("torque", PLAIN[Reason.RELEASED], record.t_us)
        elif record.event == _UNSURE:
            self._say("torque", unsure_sentence(unsure_joints(self._rig, record.a)), record.t_us)

    def _end(self, record: End) -> None:
        outcome = self.outcome
        why = Why(record.reason, record.joint, record.a, record.b)
        if self.state is State.OFF:
            self._tell(why, record.t_us)  # no change of state has told of it
        outcome.state = _STATES[record.state] if record.state < len(_STATES) else State.FAULT
        outcome.reason = self._sentence(why)
        outcome.faulty = why.faulty
        outcome.done = self._timed_out or why.reason in (Reason.TIME, Reason.DRY_RUN)
        outcome.cycles = record.cycles
        outcome.missed_deadlines = record.missed_deadlines
        outcome.missed_replies = record.missed_replies
        outcome.bus_bytes = record.bus_bytes
        outcome.unsure = unsure_joints(self._rig, record.unsure)
        outcome.readings = [Reading(joint, self._values.get(joint.name, {})) for joint in self._rig.joints]
        self.ended = True

    def _sentence(self, why: Why) -> str:
        return sentence(why, self._rig, self._label, self._first_error)

    def _say(self, kind: str, text: str, t_us: int, **fields: str) -> None:
        self._write("/event", self.t(t_us), {"kind": kind, "text": text, **fields})

    def _of_joint(self, number: int) -> Joint | None:
        return self._rig.joints[number] if number < len(self._rig.joints) else None
