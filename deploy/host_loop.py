"""Run a controller on a rig: check, arm, home, run, and torque off on every way out."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from controller.controller import Controller
from controller.errors import RunError
from controller.native import NativeCycle, pack_cycle
from controller.rig import Joint, Rig
from deploy.buses.reading import Reading
from deploy.checks import Finding, check_controller, check_derating, check_sensors, check_servos
from deploy.homing import home
from deploy.logs.cycle_message import CycleStep, CycleWords
from deploy.logs.log import RunLog
from deploy.logs.run_record import RunRecord
from deploy.period import Connection, FaultError, Periods, StopRunError
from deploy.states import State, StateMachine
from deploy.torque import hold, release, seed_goals, torque_on, unsure_sentence, write_settings

_LISTEN_STEP_S: Final = 0.01
_LISTEN_STEPS: Final = 30


@dataclass(frozen=True)
class RunOptions:
    """Say what to run.

    Args:
        goal_dist: distance of the goal at the start [m]
        goal_bearing: its direction from the heading at the start [rad]
        seconds: length of the run [s]
        arm: whether torque may be switched on; else the rig is only read
        derate: part of the torque ceiling that is allowed, in (0, 1]
    """

    goal_dist: float
    goal_bearing: float
    seconds: float
    arm: bool
    derate: float


@dataclass
class Outcome:
    """Say how a run went.

    Args:
        state: where it ended
        reason: why it ended, one sentence
        faulty: whether it ended by a fault
        done: whether it did all that was asked for
        touched: whether anything was written to the servos
        readings: what the checks read
        findings: what the checks found
        cycles: control periods
        missed_deadlines: periods that were not done in time
        missed_replies: replies that were missing or corrupt while running
        bus_bytes: bytes sent and received
        bus_sha256: SHA-256 of them all, in order
        unsure: joints whose torque is not known to be off
        pose: newest sensor values at the end of running, channel => SI
        start_pose: the same at k = 0
    """

    state: State = State.OFF
    reason: str = ""
    faulty: bool = False
    done: bool = False
    touched: bool = False
    readings: list[Reading] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    cycles: int = 0
    missed_deadlines: int = 0
    missed_replies: int = 0
    bus_bytes: int = 0
    bus_sha256: str = ""
    unsure: list[Joint] = field(default_factory=list)
    pose: Mapping[str, float] = field(default_factory=dict)
    start_pose: Mapping[str, float] = field(default_factory=dict)


def run_controller(
    link: Connection,
    rig: Rig,
    controller: Controller,
    options: RunOptions,
    log: RunLog,
    announce: Callable[[State], None] | None = None,
) -> Outcome:
    """Run a controller on a rig, from torque off to torque off.

    Args:
        link: what to talk through; the caller closes it
        rig: the rig
        controller: the controller
        options: what to run
        log: where everything is recorded; the caller closes it
        announce: told each state that is entered

    Returns:
        how it went; a fault is told there, not raised
    """
    cycle = pack_cycle(controller, rig)
    record = RunRecord(log, announce)
    periods = Periods(link, rig, controller, record)
    outcome = Outcome()
    digest, nbyte = hashlib.sha256(), 0

    def report(left: State, entered: State, reason: str) -> None:
        text = f"{left.value} -> {entered.value}: {reason}"
        periods.event("state", text, left=left.value, entered=entered.value, reason=reason)
        record.announce(entered)

    def trace(direction: str, t: float, data: bytes) -> None:
        nonlocal nbyte
        nbyte += len(data)
        digest.update(data)
        record.write("/bus", periods.t(t), {"direction": direction, "hex": data.hex()})

    link.bus.port.tap = trace
    machine = StateMachine(report)
    try:
        _check(periods, machine, options, outcome)
        if options.arm:
            outcome.touched = True
            _arm(periods, machine, options.derate)
            machine.enter(State.HOMING, "torque is on")
            home(periods)
            _run(periods, machine, controller, cycle, options, outcome)
        else:
            outcome.reason = "every check passed; nothing was written: give --arm (on the console: arm)"
            outcome.done = True
    except StopRunError as stop:
        record.hold_back()
        outcome.reason = f"stopped: {stop}"
        periods.event("stop", outcome.reason)
    except RunError as error:
        record.hold_back()
        outcome.reason = str(error)
        outcome.faulty = True
        periods.event("fault", outcome.reason)
    finally:
        # also when something unforeseen is on its way up; a stopped terminal or a full disk must not delay the release
        record.hold_back()
        try:
            _leave(periods, machine, outcome)
            link.bus.port.end_transaction()
        finally:
            link.bus.port.tap = None
            record.let_go()
        outcome.bus_bytes, outcome.bus_sha256 = nbyte, digest.hexdigest()
    if record.error is not None and not outcome.faulty:
        if not isinstance(record.error, RunError):
            raise record.error
        outcome.faulty = True
        outcome.reason = str(record.error) if outcome.done else f"{outcome.reason}; {record.error}"
    return outcome


def _check(periods: Periods, machine: StateMachine, options: RunOptions, outcome: Outcome) -> None:
    """Read everything, write nothing."""
    rig, clock = periods.rig, periods.clock
    outcome.readings, outcome.findings = check_servos(periods.link.bus, rig)
    for _ in range(_LISTEN_STEPS if periods.link.sensors is not None else 0):
        clock.sleep_until(clock.now() + _LISTEN_STEP_S)
        periods.io.read_sensors()
    outcome.findings += check_sensors(rig, periods.io.reader, periods.needed, clock.now())
    outcome.findings += check_controller(rig, periods.controller) + check_derating(rig, options.derate)
    outcome.pose = periods.io.sensor_values()
    for finding in outcome.findings:
        periods.event("finding", f"{finding.level}: {finding.text}")
    periods.heed_stop()
    errors = [finding.text for finding in outcome.findings if finding.level == "error"]
    if errors:
        raise FaultError(errors[0] + (f" (and {len(errors) - 1} more findings)" if errors[1:] else ""))
    machine.enter(State.CHECKED, "every servo is there, is the right one, and is well")


def _arm(periods: Periods, machine: StateMachine, derate: float) -> None:
    """Write settings and seed the goals; then torque on."""
    bus, rig = periods.link.bus, periods.rig
    write_settings(bus, rig, derate)
    periods.heed_stop()
    periods.goals = seed_goals(bus, rig)
    machine.enter(State.ARMED, "settings are written and read back, goals are where the joints stand")
    torque_on(bus, rig)


def _run(
    periods: Periods,
    machine: StateMachine,
    controller: Controller,
    cycle: NativeCycle,
    options: RunOptions,
    outcome: Outcome,
) -> None:
    """Step the controller until the time is over."""
    io = periods.io
    stepped: list[CycleStep] = []

    def aim() -> Sequence[int]:
        ages = io.ages_s()
        terminals, outputs, goals = cycle.step(options.goal_dist, options.goal_bearing, io.raw)
        stepped[:] = [CycleStep(io.raw.copy(), ages, terminals, outputs, goals)]
        return [int(goal) for goal in goals]

    cycle.reset()
    if periods.rig.joints[0].mode == "velocity":
        # the cycle's slew starts at rest, at whatever speed homing ended
        periods.goals = (0,) * len(periods.rig.joints)
    words = CycleWords(periods.rig, controller)
    machine.enter(State.RUNNING, "at rest in neutral, sensors are fresh")
    _look(periods)
    for k in range(round(options.seconds / periods.rig.period_s)):
        done = periods.walk(k, aim, controller.slew_rad_s)
        periods.record.write("/cycle", periods.t(done.started), words.message(k, stepped[0], done, periods.origin))
        outcome.cycles = k + 1
        outcome.missed_replies += sum(reply.status != "data" for reply in done.replies.values())
        outcome.missed_deadlines += done.overran
        outcome.pose = io.sensor_values()
        outcome.start_pose = outcome.start_pose or outcome.pose
        _look(periods)
        if done.fault:
            raise FaultError(done.fault)
        periods.heed_stop()
    periods.finish()
    outcome.pose = io.sensor_values()
    _look(periods)
    periods.heed_stop()
    outcome.reason = "the time is over"
    outcome.done = True


def _look(periods: Periods) -> None:
    """Log a virtual rig's state."""
    witness = periods.link.witness
    if witness is not None:
        seen = witness.look()
        periods.record.write("/truth", periods.t(witness.t), seen)


def _leave(periods: Periods, machine: StateMachine, outcome: Outcome) -> None:
    """Take torque from every servo, or hand it over to hold after a run that was done; then end."""
    try:
        if outcome.faulty:
            machine.enter(State.FAULT, outcome.reason)
        elif machine.state not in (State.OFF, State.CHECKED):
            machine.enter(State.STOPPING, outcome.reason or "something unforeseen happened")
    finally:
        if outcome.touched:
            _unload(periods, outcome)
    if outcome.unsure and not outcome.faulty:
        outcome.faulty = True
        outcome.reason = unsure_sentence(outcome.unsure)
    if outcome.faulty and machine.state is not State.FAULT:
        machine.enter(State.FAULT, outcome.reason)
    elif machine.state in (State.STOPPING, State.CHECKED):
        machine.enter(State.OFF, outcome.reason)
    outcome.state = machine.state


def _unload(periods: Periods, outcome: Outcome) -> None:
    bus, rig = periods.link.bus, periods.rig
    if outcome.done and rig.safety.stop == "hold":
        try:
            hold(bus, rig)
            periods.event("torque", "every servo holds its last goal")
            return
        except RunError as error:
            periods.event("torque", str(error))
            outcome.faulty = True
            outcome.reason = f"{error}; every servo was released"
    outcome.unsure = release(bus, rig, periods.clock)
    sure = "torque is off on every servo, as read back"
    periods.event("torque", unsure_sentence(outcome.unsure) if outcome.unsure else sure)
