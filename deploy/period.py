"""One period of a run: wait for its time, then read, aim, judge, write in the schedule's order.

Homing and running differ only in who aims.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from controller.controller import Controller
from controller.errors import RunError
from controller.homing import speed_inside
from controller.needed_sensors import needed_sensors
from controller.registers import registers
from controller.rig import Joint, Rig
from controller.schedule import Transaction, TransactionKind, period, schedule_of
from deploy.buses.sensor_port import SensorPort
from deploy.buses.servo_bus import BusError, Reply, ServoBus
from deploy.clock import Clock
from deploy.joint_counts import goal_limits, joint_angle, joint_speed
from deploy.logs.run_record import RunRecord
from deploy.rig_io import RigIO
from deploy.safety import (
    Watch,
    judge_alert,
    judge_encoders,
    judge_hardware_error,
    judge_health,
    judge_replies,
    judge_sensors,
    judge_speeds,
    judge_tilt,
    judge_timing,
    judge_torque,
    judge_tracking,
)
from deploy.witness import Witness

TRIPPED: Final = 255
"""What the bus watchdog register reads once it has stopped its servo."""


class FaultError(RunError):
    """Report that something persistent is wrong: the run must stop."""


class StopRunError(Exception):
    """Say that a person wants the run to stop."""


@dataclass(frozen=True)
class Connection:
    """Hold what a run talks through.

    Args:
        bus: the servos
        sensors: the sensor node's port, or None
        clock: the time of both
        witness: of a virtual rig, for the log, or None; the loop never looks at what it saw
        stop: gives the reason why a person wants to stop, or None
    """

    bus: ServoBus
    sensors: SensorPort | None
    clock: Clock
    witness: Witness | None
    stop: Callable[[], str | None]


Aim: TypeAlias = Callable[[], Sequence[int]]
"""Gives the goals of a period [counts], (njoint,), once its data have been read."""


@dataclass
class Period:
    """Hold what happened in one period.

    Args:
        late_s: start behind the schedule [s]
        started: when it started [s]
        read: when everything had been read [s]
        aimed: when the goals were known [s]
        ended: when they had been written [s]
        replies: servo id => reply
        written: when the goals were handed to the port [s], or None
        overran: whether it was not done in its time
        fault: the sentence that ends the run, or None
    """

    late_s: float
    started: float
    read: float = 0.0
    aimed: float = 0.0
    ended: float = 0.0
    replies: dict[int, Reply] = field(default_factory=dict)
    written: float | None = None
    overran: bool = False
    fault: str | None = None


class Periods:
    """Walk through a run's periods on an absolute schedule, keeping the rig's newest data and what has lasted.

    Args:
        link: what the run talks through
        rig: the rig
        controller: the controller, for the sensors that it needs
        record: of the run
    """

    def __init__(self, link: Connection, rig: Rig, controller: Controller, record: RunRecord) -> None:
        self.link = link
        self.rig = rig
        self.controller = controller
        self.record = record
        self.clock = link.clock
        self.origin = link.clock.now()
        self.io = RigIO(rig, link.bus, link.sensors, link.clock)
        self.watch = Watch()
        self.needed = needed_sensors(rig, controller)
        self.goals: tuple[int, ...] = ()
        self._schedule = schedule_of(rig)
        self._begin = self._ended = self.origin

    def t(self, at: float | None = None) -> float:
        """Return a time since the start of the run [s].

        Args:
            at: on the run's clock; None: now
        """
        return (self.clock.now() if at is None else at) - self.origin

    def event(self, kind: str, text: str, **fields: str) -> None:
        """Log an event.

        Args:
            kind: of event
            text: one sentence
            **fields: further fields of the message
        """
        self.record.write("/event", self.t(), {"kind": kind, "text": text, **fields})

    def start(self) -> None:
        """Let the first period start one period from now."""
        self._begin = self._ended = self.clock.now()

    def walk(self, k: int, aim: Aim, rate_rad_s: float) -> Period:
        """Wait for the next period's time and do what is due in it; a fault keeps the goals from being written.

        Args:
            k: number of the period
            aim: gives the goals
            rate_rad_s: largest rate that they should have [rad/s]; 0: any

        Returns:
            what happened
        """
        self._wait()
        started = self.clock.now()
        done = Period(started - self._begin, started, fault=self._stalled(started))
        goals: Sequence[int] = ()
        for due in period(self._schedule, k):
            if due.kind is TransactionKind.READ_STATE:
                done.replies = self.io.read_servos(due.address, due.size)
                self.io.read_sensors()
                done.read = self.clock.now()
            elif due.kind is TransactionKind.RUN_CYCLE:
                goals = aim()
                done.aimed = self.clock.now()
                done.fault = done.fault or self._judge(done.replies)
            elif due.kind is TransactionKind.WRITE_GOALS:
                done.fault = done.fault or self._refuse(goals, rate_rad_s)
                if done.fault is None:
                    self.goals = self._inside(goals)
                    done.written = self.io.write_goals(self.goals, due.address)
                done.ended = self.clock.now()
            elif done.fault is None:
                done.fault = self._look_after_health(due)
        self._ended = self.clock.now()
        done.overran = self._ended > self._begin + self.rig.period_s
        done.fault = done.fault or judge_timing(self.rig, self.watch, done.overran)
        return done

    def finish(self) -> None:
        """Wait for the end of the last period; look at the sensors once more."""
        self.clock.sleep_until(self._begin + self.rig.period_s)
        self.io.read_sensors()

    def _wait(self) -> None:
        # a period that is more than one period late makes all later ones late by whole periods: no catching up
        self._begin += self.rig.period_s
        behind = self.clock.now() - self._begin
        if behind > self.rig.period_s:
            self._begin += self.rig.period_s * math.floor(behind / self.rig.period_s)
        self.clock.sleep_until(self._begin)

    def heed_stop(self) -> None:
        """Raise if a person wants the run to stop.

        Raises:
            StopRunError: with the reason
            RunError: if the run can not be recorded any more
        """
        if self.record.error is not None:
            raise self.record.error
        reason = self.link.stop()
        if reason is None and self.io.reader.emergency_stop:
            reason = "the sensor node sent an emergency stop"
        if reason is not None:
            raise StopRunError(reason)

    def _judge(self, replies: Mapping[int, Reply]) -> str | None:
        """Return the sentence of a fault that this period's data show, or None."""
        rig, watch, io = self.rig, self.watch, self.io
        ages = io.ages_s()[3 * len(rig.joints) :]
        return (
            judge_replies(rig, watch, replies)
            or self._alerts(replies)
            or judge_encoders(rig, watch, self._begin, self.clock.now(), replies, io.angles_rad())
            or judge_sensors(rig, watch, self.needed, ages)
            or self._tracking()
            or self._tilt(ages)
        )

    def _tracking(self) -> str | None:
        """Return the sentence of a fault if a joint does not do what it is told, or None."""
        rig, io, now = self.rig, self.io, self.clock.now()
        if math.inf in io.ages_s()[: len(rig.joints)]:
            return None  # nobody knows where a joint is that has never answered
        if rig.joints[0].mode == "velocity":
            return judge_speeds(rig, self.watch, now, self.goals, io.velocity_counts(), io.angles_rad())
        goals = [joint_angle(joint, goal) for joint, goal in zip(rig.joints, self.goals, strict=True)]
        return judge_tracking(rig, self.watch, now, goals, io.angles_rad())

    def _refuse(self, goals: Sequence[int], rate_rad_s: float) -> str | None:
        """Take a last look at limits and rate, which those who aim should have kept; return what is wrong, or None."""
        for joint, last, goal in zip(self.rig.joints, self.goals, goals, strict=True):
            low, high = goal_limits(joint)
            if not low <= goal <= high:
                return f"joint {joint.name}: goal {goal} is outside {low} to {high}; report this as a defect"
            unit, of, count = "rad", joint_angle, 2.0 * math.pi / joint.product.ticks_per_turn
            if joint.mode == "velocity":
                unit, of, count = "rad/s", joint_speed, joint.product.velocity_unit_rad_s
                if not joint.unlimited and 0 in (last, goal):
                    continue  # near an end of its travel a joint is stopped at once, and let go at once
            step = abs(of(joint, goal) - of(joint, last))
            step_max = rate_rad_s * self.rig.period_s + count
            if rate_rad_s > 0.0 and step > 1.001 * step_max:
                return (
                    f"joint {joint.name}: goal {goal} is {step:.4f} {unit} from the last one, {step_max:.4f} {unit} "
                    "are allowed; report this as a defect"
                )
        return None

    def _inside(self, goals: Sequence[int]) -> tuple[int, ...]:
        """Return the goals, without the speed of a joint that it may have carried to an end of its travel.

        The control cycle stops a joint that would pass its end within a period of its newest angle; while replies are
        missing that angle is old, and the joint has gone on since.
        """
        kept = tuple(int(goal) for goal in goals)
        if self.rig.joints[0].mode == "position":
            return kept
        seen = zip(self.rig.joints, self.io.position_counts(), kept, self.io.ages_s(), strict=False)
        return tuple(speed_inside(joint, count, goal, age, self.rig.period_s) for joint, count, goal, age in seen)

    def _stalled(self, now: float) -> str | None:
        """Return the sentence of a fault if the host was silent for so long that a watchdog has tripped, or None."""
        silent_s = now - self._ended
        if not 0.0 < self.rig.safety.watchdog_s < silent_s:
            return None
        for joint in self.rig.joints:
            watchdog = joint.family.watchdog
            if watchdog is None:
                continue
            try:
                tripped = self.link.bus.read_register(joint.id, registers(joint.product)[watchdog]) == TRIPPED
            except BusError:
                continue  # one that stays silent is found otherwise
            if tripped:
                return (
                    f"the host was silent for {silent_s:.2f} s, so the servos' bus watchdogs "
                    f"({self.rig.safety.watchdog_s:g} s) have stopped them; free the processor, or use --realtime"
                )
        return None

    def _look_after_health(self, due: Transaction) -> str | None:
        """Read one servo's health registers; return the sentence of a fault, or None."""
        joint = self.rig.joints[due.servo]
        counts = self.io.read_health(due.servo, due.address, due.size)
        if not counts:
            return None
        told = health_fields(joint, counts)
        self.record.write("/health", self.t(), {"joint": joint.name, "id": joint.id, **told})
        fault: str | None = None
        if told.get("hardware_error") and joint.family.protocol == "dynamixel-2.0":
            # elsewhere each reply tells it, and it comes and goes with its cause: see `judge_alert`
            fault = judge_hardware_error(joint, int(told["hardware_error"]), self._shutdown(joint))
        if "torque" in told:
            fault = fault or judge_torque(joint, int(told["torque"]))
        if "voltage_v" in told:
            fault = fault or judge_health(self.rig, self.watch, joint, told["voltage_v"], told["temperature_c"])
        return fault

    def _alerts(self, replies: Mapping[int, Reply]) -> str | None:
        for joint in self.rig.joints:
            if judge_alert(self.watch, joint, replies[joint.id]):
                fault = judge_hardware_error(joint, self._hardware_error(joint), self._shutdown(joint))
                if fault:
                    return fault
        return None

    def _shutdown(self, joint: Joint) -> int | None:
        register = registers(joint.product)[joint.family.shutdown]
        try:
            return self.link.bus.read_register(joint.id, register, attempts=1)
        except BusError:
            return None  # the sentence does without it

    def _hardware_error(self, joint: Joint) -> int:
        """Ask again what is wrong with a servo that has reported something, for a byte may have been damaged."""
        family, table = joint.family, registers(joint.product)
        if family.hardware_error is None:
            register = table[family.torque_enable]
            reply = self.link.bus.read(joint.id, register.address, register.size)
            return reply.error if reply.status == "data" else 0
        try:
            return self.link.bus.read_register(joint.id, table[family.hardware_error])
        except BusError:
            return 0  # the alert comes again with the next reply

    def _tilt(self, ages: Sequence[float]) -> str | None:
        rig = self.rig
        number = {sensor.name: number for number, sensor in enumerate(rig.sensors)}
        if not {"roll", "pitch"} <= number.keys():
            return None
        if any(ages[number[name]] > rig.sensors[number[name]].age_s_max for name in ("roll", "pitch")):
            return None  # an old pose says nothing about now
        values = self.io.sensor_values()
        return judge_tilt(rig, self.watch, values["roll"], values["pitch"])


def health_fields(joint: Joint, counts: Mapping[str, int]) -> dict[str, float | int]:
    """Return the fields of `/health` that registers give.

    Args:
        joint: whose
        counts: register => count
    """
    family, table = joint.family, registers(joint.product)
    fields = {
        family.torque_enable: "torque",
        family.hardware_error: "hardware_error",
        family.voltage: "voltage_v",
        family.temperature: "temperature_c",
    }
    told: dict[str, float | int] = {}
    for name, field_name in fields.items():
        if name is not None and name in counts:
            scale = table[name].scale
            told[field_name] = counts[name] if scale == 1.0 else round(counts[name] * scale, 6)
    return told
