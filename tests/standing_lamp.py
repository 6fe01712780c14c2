"""A virtual lamp that stands by its own torque, and a master that speaks to it in bytes."""

from functools import reduce
from operator import xor

from controller.registers import registers
from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.rig import VirtualRig

RIG = load_rig("lamp-xc330")
IDS = [joint.id for joint in RIG.joints]
LINES = registers(RIG.joints[0].product)
PERIOD_S = RIG.period_s
READ_BLOCK = dxl.encode(dxl.BROADCAST, dxl.SYNC_READ, (126).to_bytes(2, "little") + b"\x0a\x00" + bytes(IDS))


def write(rig, name, values):
    """Write a register of each servo; the answers are dropped."""
    line = LINES[name]
    for servo, value in zip(IDS, values, strict=True):
        data = line.address.to_bytes(2, "little") + value.to_bytes(line.size, "little")
        rig.transmit(dxl.encode(servo, dxl.WRITE, data), rig.now)
        rig.advance(rig.now + 1e-3)
        rig.replies_until(rig.now)


def goals(rig, ticks):
    data = b"".join(bytes([servo]) + goal.to_bytes(4, "little") for servo, goal in zip(IDS, ticks, strict=True))
    rig.transmit(dxl.encode(dxl.BROADCAST, dxl.SYNC_WRITE, bytes([116, 0, 4, 0]) + data), rig.now)


def read(rig, name):
    """Read a register of each servo."""
    line = LINES[name]
    question = line.address.to_bytes(2, "little") + line.size.to_bytes(2, "little") + bytes(IDS)
    rig.transmit(dxl.encode(dxl.BROADCAST, dxl.SYNC_READ, question), rig.now)
    rig.advance(rig.now + 5e-3)
    answers = dxl.PacketParser().feed(b"".join(frame for _, frame in rig.replies_until(rig.now)))
    return [int.from_bytes(answer.parameters[1:], "little", signed=line.signed) for answer in answers]


def standing(**settings):
    """Return a rig that stands by its own torque."""
    rig = VirtualRig(RIG, **settings)
    write(rig, "position_p_gain", [joint.p_gain for joint in RIG.joints])
    write(rig, "position_d_gain", [joint.d_gain for joint in RIG.joints])
    goals(rig, [joint.zero_tick for joint in RIG.joints])
    write(rig, "torque_enable", [1, 1, 1])
    rig.advance(rig.now + 0.2)
    return rig


def lines_of(data):
    """Return the checked lines in sensor bytes: (letter, seq, t_us, counts)."""
    lines = []
    for line in data.split(b"\r\n")[:-1]:
        body, _, check = line.removeprefix(b"$").rpartition(b"*")
        if check == b"%02X" % reduce(xor, body, 0):
            letter, seq, t_us, *counts = body.decode().split(",")
            lines.append((letter, int(seq), int(t_us), [int(count) for count in counts]))
    return lines
