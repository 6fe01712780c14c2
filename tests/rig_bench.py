"""A virtual rig in lock step, a run of the host loop on it, and what is left behind: for tests of the host loop."""

from dataclasses import replace

import dynamixel_sdk
import scservo_sdk

from controller import controller_text, load_rig, parse_controller, registers
from deploy.buses.lockstep_port import LockstepPort
from deploy.connection import connect_virtual
from deploy.host_loop import RunOptions, run_controller
from deploy.logs.log import RunLog, read_log
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig

RIG = load_rig("lamp-xc330")

INPUTS = """
[[input]]
name = "px"
unit = "m"
low = -2
high = 2
[[input]]
name = "s0"
unit = "N"
low = 0
high = 20
"""

SWAY = (
    """
program = "(list (* 10 (osc-wave 0.5 0)) (* 8 (osc-wave 0.5 0.25)) (- (* -6 (osc-wave 0.5 0.5)) (* 0.01 (+ px s0))))"
[controller]
name = "sway"
period_s = 0.02
slew_rad_s = 1.5"""
    + INPUTS
    + "".join(
        f'[[output]]\nname = "{name}"\nkind = "position"\nunit = "deg"\nlow = -60\nhigh = 60\nneutral = 0\n'
        for name in ("a0", "a1", "a2")
    )
)


def sway(**changes):
    return replace(parse_controller(SWAY, "sway"), **changes)


class Bench:
    """A virtual rig, a run on it, and what is left behind."""

    def __init__(self, tmp_path, *faults, rig=RIG, **virtual):
        self.rig = rig
        self.virtual = VirtualRig(rig, faults=[parse_fault(fault) for fault in faults], **virtual)
        self.path = tmp_path / "run.mcap"
        self.announce = None

    def run(self, seconds=2.0, stop=lambda bench: None, controller=None, **options):
        controller = controller or sway()
        options = RunOptions(
            **{"goal_dist": 0.4, "goal_bearing": 0.0, "seconds": seconds, "arm": True, "derate": 1.0} | options
        )
        meta = {"format": 1, "rig": self.rig.name, "rig_text": self.rig.text, "controller": controller.name}
        meta |= {
            "controller_text": controller_text(controller),
            "goal_dist": 0.4,
            "goal_bearing": 0.0,
            "period_s": 0.02,
        }
        with RunLog(self.path) as log, connect_virtual(self.virtual, lambda: stop(self)) as link:
            log.write("/meta", 0.0, meta)
            self.link = link
            outcome = run_controller(link, self.rig, controller, options, log, self.announce)
        self.log = read_log(self.path)
        assert self.log.complete
        return outcome

    def torque(self):
        return [servo.table["torque_enable"] for servo in self.virtual.servos]

    def states(self):
        return ["off", *(event["entered"] for event in self.log.events if event["kind"] == "state")]

    def frames(self, instruction):
        return [
            bytes.fromhex(frame["hex"])
            for frame in self.log.messages["/bus"]
            if frame["direction"] == "tx" and int(frame["hex"][14:16], 16) == instruction
        ]

    def written(self):
        """Return what was sent to be written: time, servo, address, bytes; of single and of sync writes."""
        found = []
        for frame in self.log.messages["/bus"]:
            if frame["direction"] == "tx":
                found += [(frame["t"], *write) for write in _writes(bytes.fromhex(frame["hex"]))]
        return found

    def goals(self):
        """Return the goals sent: joint => [(time, count)], seeds included."""
        goals = {joint.name: [] for joint in self.rig.joints}
        for t, servo, address, data in self.written():
            for joint in self.rig.joints:
                register = registers(joint.product)[joint.family.goal(joint.mode)]
                if (servo, address) == (joint.id, register.address):
                    goals[joint.name].append((t, _count(register, data)))
        return goals

    def torque_read_back(self):
        return torque_read_back(self.virtual)


def torque_read_back(virtual):
    """Return every servo's torque as the vendor's own client reads it, once nothing is wrong any more."""
    virtual.set_faults([])
    virtual.advance(virtual.now + 1.0)
    virtual.replies_until(virtual.now)  # what was late is over
    rig = virtual.rig
    kind, version = rig.bus.protocol.split("-")
    sdk = scservo_sdk.PacketHandler(0) if kind == "feetech" else dynamixel_sdk.PacketHandler(float(version))
    read = {}
    with LockstepBench(virtual) as bench:
        port = LockstepPort(bench, rig.bus.baud)
        for joint in rig.joints:
            address = registers(joint.product)["torque_enable"].address
            for _ in range(3):  # as its users do
                value, result, _ = sdk.read1ByteTxRx(port, joint.id, address)
                read[joint.name] = value if result == 0 else None
                if result == 0:
                    break
        port.closePort()
    return read


def _writes(frame):
    """Yield the servo, address and bytes of each write in an instruction packet, without any code of ours."""
    if frame[:4] == b"\xff\xff\xfd\x00":
        servo, instruction, parameters, wide = frame[4], frame[7], frame[8:-2], 2
    else:
        servo, instruction, parameters, wide = frame[2], frame[4], frame[5:-1], 1
    address = int.from_bytes(parameters[:wide], "little")
    if instruction == 0x03:
        yield servo, address, parameters[wide:]
    elif instruction == 0x83:
        size = int.from_bytes(parameters[wide : 2 * wide], "little")
        rest = parameters[2 * wide :]
        for start in range(0, len(rest), size + 1):
            yield rest[start], address, rest[start + 1 : start + 1 + size]


def _count(register, data):
    """Return a count by the encodings that the manuals state."""
    value = int.from_bytes(data, register.byte_order)
    if register.encoding == "twos":
        return value - (1 << 8 * register.size) if value >> (8 * register.size - 1) else value
    if register.encoding == "unsigned":
        return value
    bit = int(register.encoding.removeprefix("sign"))
    return -(value & ((1 << bit) - 1)) if value >> bit & 1 else value
