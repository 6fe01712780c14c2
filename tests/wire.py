"""A client that asks a virtual rig's servos by their registers' names, whatever they speak: for tests on the wire."""

from controller.register import decode_register, encode_register
from controller.registers import registers
from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual import protocol1 as p1
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig

LAMP = load_rig("lamp-xc330")
PATIENCE_S = 0.004


class Wire:
    """Ask a rig's servos by their registers' names, and wait so long for answers."""

    def __init__(self, *faults, rig=LAMP, **settings):
        self.about = rig
        self.rig = VirtualRig(rig, faults=[parse_fault(spec) for spec in faults], **settings)
        self.joints = {joint.id: joint for joint in rig.joints}
        self.new = rig.bus.protocol == "dynamixel-2.0"

    def send(self, servo, instruction, data):
        code = dxl if self.new else p1
        self.rig.transmit(code.encode(servo, instruction, data), self.rig.now)

    def hear(self, seconds=PATIENCE_S):
        """Return the packets that come within a time: (when, frame)."""
        self.rig.advance(self.rig.now + seconds)
        return self.rig.replies_until(self.rig.now)

    def frames(self, servo, instruction, data=b"", seconds=PATIENCE_S):
        self.send(servo, instruction, data)
        return self.hear(seconds)

    def line(self, servo, name):
        return registers(self.joints[servo].product)[name]

    def place(self, *numbers):
        return b"".join(number.to_bytes(2 if self.new else 1, "little") for number in numbers)

    def read(self, servo, name):
        """Return a register's count, or None for silence."""
        line = self.line(servo, name)
        heard = self.frames(servo, 2, self.place(line.address, line.size))
        if not heard:
            return None
        [packet] = (dxl if self.new else p1).PacketParser().feed(heard[0][1])
        return decode_register(line, packet.parameters[-line.size :])

    def write(self, servo, name, count):
        line = self.line(servo, name)
        return self.frames(servo, 3, self.place(line.address) + encode_register(line, count))

    def stand(self):
        """Switch all servos on at their neutral places."""
        for servo, joint in self.joints.items():
            for name, count in joint.gains.items():
                if not self.line(servo, name).eeprom:
                    self.write(servo, name, count)
            self.write(servo, joint.family.goal_position, joint.zero_tick)
            self.write(servo, "torque_enable", 1)
        self.rig.advance(self.rig.now + 0.3)
        return self

    def positions(self):
        return [self.read(servo, "present_position") for servo in self.joints]

    def faults(self, *specs):
        self.rig.set_faults([parse_fault(spec) for spec in specs])
