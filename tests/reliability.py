"""What each fault does in each state of a run, on servos of each family: run, judged, and written as a page."""

import argparse
import itertools
import math
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from rig_bench import INPUTS, Bench, sway

from controller import load_rig, parse_controller
from deploy.host_loop import State
from deploy.joint_counts import count_limits, goal_limits, joint_angle
from deploy.virtual.faults import parse_fault

PAGE = Path(__file__).parent.parent / "docs" / "reliability.md"
RIGS = {name: load_rig(name) for name in ("lamp-xc330", "lamp-xl430", "lamp-ax12", "lamp-sts3215", "jumper-xc330")}
COAST_RAD = 0.2  # at 4 rad/s, with a body that hops on it
STATES = ("homing", "running", "stopping")
SLEW_RAD_S = 1.5  # of the controller that is run, or 60 rad/s^2 where it gives speeds
TREAD = (
    """
program = '''(list (* 2 (osc-wave 1 0.25)) (* 4 (osc-wave 1 0.25)) (* -4 (osc-wave 1 0.25))
  (+ (* 4 (osc-wave 1 0.25)) (* 0.01 (+ px s0))))'''
[controller]
name = "tread"
period_s = 0.02
slew_rad_s = 60.0"""
    + INPUTS
    + "".join(
        f'[[output]]\nname = "a{number}"\nkind = "velocity"\nunit = "rad/s"\nlow = -6\nhigh = 6\nneutral = 0\n'
        for number in range(4)
    )
)

FAULTS = {
    "dead=2": "servo 2 loses its power",
    "mute=2": "the line to servo 2 is cut; it drives on",
    "dead=2 for 0.3 s": "servo 2 restarts",
    "brownout": "all servos lose their power",
    "brownout for 0.3 s": "all servos restart",
    "drop=1": "no reply arrives",
    "corrupt=1": "every reply is damaged",
    "truncate=1": "every reply loses its end",
    "late=1:40": "every reply comes 40 ms late",
    "latency-timer=16": "the adapter holds bytes back for up to 16 ms",
    "deaf=1": "no servo hears the master",
    "duplicate=1": "every reply comes twice",
    "unsolicited=1": "an old reply follows each reply",
    "duplicate-id=2": "servo 3 answers to id 2 as well",
    "unplug": "the adapter is unplugged",
    "unplug for 0.3 s": "the adapter is unplugged and plugged in again",
    "supply=low": "the supply is a tenth below what the rig allows",
    "overload=2": "servo 2 reports an overload",
    "overheat=2": "servo 2 reports overheating",
    "wrap=2:1000": "the encoder of servo 2 jumps by 1000 counts",
    "stuck=2": "the horn of servo 2 is stuck",
    "sensor-silent": "the sensor node falls silent",
    "sensor-babble": "the sensor node sends garbage between its lines",
    "estop": "the sensor node sends its emergency stop",
}


@dataclass(frozen=True)
class Cell:
    """What came of one fault in one state."""

    done: bool
    end: str
    reason: str
    unsure: tuple[str, ...]

    @property
    def status(self):
        return 0 if self.done else 1

    def text(self):
        told = self.reason
        if self.unsure:
            told += f" – not known to be off: {', '.join(self.unsure)}"
        return told


class Strike(Bench):
    """A run that a fault strikes in a state: a few periods into homing or running, or at the moment of stopping."""

    def __init__(self, path, name, fault, state):
        rig = RIGS[name]
        if fault.startswith("stuck"):  # far enough from its goal to be seen before the servo's own protection trips
            rig = replace(rig, safety=replace(rig.safety, tracking_rad_max=0.08, tracking_s_max=0.2))
        super().__init__(path, rig=rig, start="limp" if state == "homing" else "settled")
        if state == "homing":
            self.virtual.advance(1.0)
        self.fault, self.state, self.at, self.periods = fault, state, None, 0
        self.announce = self._entered

    def _entered(self, state):
        self.at, self.periods = state, 0

    def strike(self):
        spec, _, lasting = self.fault.partition(" for ")
        spec = spec.replace("low", f"{0.9 * self.rig.safety.voltage_low_v:.2f}")
        now = self.virtual.now
        end = f"-{now + float(lasting.removesuffix(' s')):.6f}" if lasting else ""
        self.virtual.set_faults([parse_fault(f"{spec}@{now:.6f}{end}")])
        self.virtual.advance(now)

    def stop(self):
        self.periods += 1
        struck = State.HOMING if self.state == "homing" else State.RUNNING
        if self.at is struck and self.periods == 5:
            self.strike()
            return "a key was pressed" if self.state == "stopping" else None
        return None

    def cell(self):
        outcome = self.run(2.0, stop=lambda bench: bench.stop(), controller=controller_of(self.rig))
        self.outcome = outcome
        done = outcome.done and not outcome.faulty
        return Cell(done, outcome.state.value, outcome.reason, tuple(joint.name for joint in outcome.unsure))


def controller_of(rig, gently=False):
    """Return a controller that keeps a rig moving, by angles or by speeds; gently: for as long as one likes."""
    if rig.joints[0].mode == "position":
        return sway()
    return parse_controller(TREAD.replace("6\n", "1\n") if gently else TREAD, "tread")


def run_cell(path, name, fault, state):
    """Run one cell, hold it to what must be true of all, and return what came of it."""
    on = Strike(path, name, fault, state)
    cell = on.cell()
    assert on.log.complete  # closed, and every message of it can be read
    check_goals(on)
    check_freshness(on)
    torque = on.torque_read_back()
    off = {joint for joint, value in torque.items() if value == 0}
    assert off | set(cell.unsure) == set(torque), f"torque is on and nobody was told: {torque}"
    assert "\n" not in cell.reason and cell.reason
    assert cell.done or cell.reason != "the time is over"
    return cell


def check_goals(on):
    """No goal is beyond its joint's limits, or farther from the last one than homing and controller allow."""
    if on.rig.joints[0].mode == "velocity":
        return check_speeds(on)
    rate = max(SLEW_RAD_S, on.rig.safety.homing_rad_s)
    for joint in on.rig.joints:
        low, high = count_limits(joint)
        track = [count for _, count in on.goals()[joint.name]]
        step_max = rate * on.rig.period_s + 2 * math.pi / joint.product.ticks_per_turn
        assert all(low <= count <= high for count in track)
        for a, b in itertools.pairwise(track):
            assert abs(joint_angle(joint, b) - joint_angle(joint, a)) <= step_max * 1.001
    return None


def check_speeds(on):
    """No goal is faster than its joint may turn, and none drives a joint farther beyond its limits than it coasts."""
    for joint in on.rig.joints:
        low, high = goal_limits(joint)
        assert all(low <= count <= high for _, count in on.goals()[joint.name])
        for truth in on.log.messages.get("/truth", []):
            assert joint.low_rad - COAST_RAD < truth["joint_rad"][joint.name] < joint.high_rad + COAST_RAD


def check_freshness(on):
    """What passes for fresh is where the joint is now; what is not is held, and known to be old."""
    last = None
    truths = on.log.messages.get("/truth", [])[1:]
    for cycle, truth in zip(on.log.cycles, truths, strict=False):
        for joint in on.rig.joints:
            raw, age = cycle["raw"][joint.name], cycle["age_s"][joint.name]
            if joint.id in cycle["missed"]:
                assert age is None or age > 0.5 * on.rig.period_s
                assert last is None or raw == last["raw"][joint.name]
            elif not on.fault.startswith(("wrap", "duplicate-id")):
                stands = joint.zero_tick + joint.sign * truth["joint_rad"][
                    joint.name
                ] * joint.product.ticks_per_turn / (2 * math.pi)
                assert age < on.rig.period_s
                moved = on.rig.period_s * abs(truth["joint_vel"][joint.name])  # since it was read
                assert abs(raw - stands) * 2 * math.pi / joint.product.ticks_per_turn < 0.05 + moved
        last = cycle


def page(told):
    """Return the page: (rig, fault, state) => (status, what is said)."""
    lines = [
        "# What faults do to a run",
        "",
        "Made by `tests/reliability.py` from runs of the host loop on virtual rigs in lock step: each fault strikes",
        "five periods into homing or into running, or at the moment when a key stops the run, and lasts unless it says",
        "otherwise. `tests/test_reliability.py` runs a part of it every time, all of it with `--long`. In every run",
        "",
        "- no goal is beyond its joint's limits, or moves faster than homing or the controller may;",
        "- what passes for fresh is where the joint is, and what is held has its age;",
        "- the log is closed and readable;",
        "- torque is off on every servo, as the vendor's own client reads it back once nothing is wrong any more, or",
        "  the joint is named as not known to be off.",
        "",
        "Status is that of `servolve deploy`: 0, the run was done; 1, it was not.",
    ]
    for name in RIGS:
        lines += ["", f"## {name}", ""]
        lines += ["| fault | state | status | what is said |", "|---|---|---|---|"]
        for fault, state in itertools.product(FAULTS, STATES):
            if (name, fault, state) in told:
                status, text = told[name, fault, state]
                lines.append(f"| `{fault}`: {FAULTS[fault]} | {state} | {status} | {text} |")
    return "\n".join(lines) + "\n"


def read_page():
    """Return what the page says: (rig, fault, state) => (status, text)."""
    told, name = {}, ""
    for line in PAGE.read_text().splitlines() if PAGE.exists() else []:
        if line.startswith("## "):
            name = line[3:]
        elif line.startswith("| `"):
            fault, state, status, text = (part.strip() for part in line.strip("|").split("|"))
            told[name, fault.split("`")[1], state] = (int(status), text)
    return told


def main():
    """Run the cells and write them to the page."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "--only", default="", help="run the cells whose name holds this, and leave the others as they are"
    )
    only = parser.parse_args().only
    told = {}
    for cell in itertools.product(RIGS, FAULTS, STATES):
        if only in " ".join(cell):
            with tempfile.TemporaryDirectory() as folder:
                came = run_cell(Path(folder), *cell)
            told[cell] = (came.status, came.text())
            sys.stdout.write(f"{' | '.join(cell)} | {came.status} | {came.text()}\n")
    PAGE.write_text(page(read_page() | told))


if __name__ == "__main__":
    main()
