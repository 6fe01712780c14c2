"""A master on a virtual Dynamixel 2.0 line, in process: its own packets, and the vendor's SDK."""

from dynamixel_sdk import PortHandler

from controller.registers import registers
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.rig import VirtualRig


def block(*values):
    return b"".join(value.to_bytes(2, "little") for value in values)


class Master:
    """Ask a virtual rig, each question after the answers to the last."""

    def __init__(self, rig, **settings):
        self.rig = VirtualRig(rig, **settings)
        self.lines = {joint.id: registers(joint.product) for joint in rig.joints}
        self.t = 0.0

    def line(self, servo, name):
        return self.lines.get(servo, next(iter(self.lines.values())))[name]

    def frames(self, frame):
        """Send a frame; return the answers with their times."""
        self.asked = self.rig.transmit(frame, max(self.t, self.rig.now))
        self.t = self.asked
        answers = []
        while (event := self.rig.next_event()) is not None:
            answers += self.rig.replies_until(event)
            self.t = event
        return answers

    def ask(self, servo, instruction, parameters=b""):
        """Send an instruction; return the status packets as (id, error, data)."""
        answers = self.frames(dxl.encode(servo, instruction, parameters))
        packets = dxl.PacketParser().feed(b"".join(frame for _, frame in answers))
        assert all(packet.instruction == dxl.STATUS for packet in packets)
        return [(packet.id, packet.parameters[0], packet.parameters[1:]) for packet in packets]

    def data(self, servo, name, value):
        line = self.line(servo, name)
        return (value % (1 << 8 * line.size)).to_bytes(line.size, "little")

    def write(self, servo, name, value):
        """Write a register; return the error, or None for silence."""
        answers = self.ask(servo, dxl.WRITE, block(self.line(servo, name).address) + self.data(servo, name, value))
        return answers[0][1] if answers else None

    def set(self, servo, **values):
        """Write registers, all of which are taken."""
        for name, value in values.items():
            assert self.write(servo, name, value) == 0, name

    def read(self, servo, name):
        """Read a register; return its count."""
        line = self.line(servo, name)
        [(_, error, data)] = self.ask(servo, dxl.READ, block(line.address, line.size))
        assert error & ~dxl.ALERT == 0, name
        return int.from_bytes(data, "little", signed=line.signed)

    def wait(self, seconds):
        self.t = max(self.t, self.rig.now) + seconds
        self.rig.advance(self.t)


class SdkPort(PortHandler):
    """Let the vendor's SDK talk to a virtual rig in this process: it has a timeout when no answer is on its way."""

    def __init__(self, rig):
        super().__init__("virtual")
        self.rig = rig
        self.waiting = bytearray()

    def openPort(self):  # noqa: N802
        return True

    def clearPort(self):  # noqa: N802
        self.waiting.clear()

    def getBytesAvailable(self):  # noqa: N802
        return len(self.waiting)

    def writePort(self, packet):  # noqa: N802
        self.rig.transmit(bytes(packet), self.rig.now)
        return len(packet)

    def readPort(self, length):  # noqa: N802
        if len(self.waiting) < length:
            self.hear()
        data = bytes(self.waiting[:length])
        del self.waiting[:length]
        return data

    def setPacketTimeout(self, packet_length):  # noqa: N802
        pass

    def setPacketTimeoutMillis(self, msec):  # noqa: N802
        pass

    def isPacketTimeout(self):  # noqa: N802
        return not self.waiting and self.rig.next_event() is None

    def hear(self):
        while (event := self.rig.next_event()) is not None:
            self.rig.advance(event)
            for _, frame in self.rig.replies_until(event):
                self.waiting += frame
