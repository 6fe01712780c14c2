"""The firmware's bus master and the host's, driven alike: each with its end of a line, and questions of one form."""

from runtime_shim import Said
from scripted_port import ScriptedPort


class Line:
    """The other end of the firmware's line, and time that only waiting moves."""

    def __init__(self, answer):
        self.now_us = 0
        self.answer = answer
        self.asked = []
        self._coming = []
        self._waiting = b""

    def send(self, frame):
        self.asked.append((self.now_us, frame))
        self._coming = sorted(self._coming + [(self.now_us + delay, data) for delay, data in self.answer(frame)])
        return len(frame)

    def wait(self, until_us):
        if self._waiting:
            return
        if not self._coming or self._coming[0][0] > until_us:
            self.now_us = max(self.now_us, until_us)
            return
        at, data = self._coming.pop(0)
        self.now_us = max(self.now_us, at)
        self._waiting += data

    def take(self, size):
        taken, self._waiting = self._waiting[:size], self._waiting[size:]
        return taken

    def rest(self, delay_us):
        """Let time pass; what comes then waits."""
        self.now_us += delay_us
        while self._coming and self._coming[0][0] <= self.now_us:
            self._waiting += self._coming.pop(0)[1]


class HostPort(ScriptedPort):
    """The host's port with the same script, its time held to whole microseconds."""

    def __init__(self, answer, patience_us):
        super().__init__(answer)
        self.latency_s = 1e-6 * patience_us
        self.asked = []

    def wait(self, deadline):
        while not self.waiting():
            if not self.coming or self.coming[0][0] > us(deadline):
                self.time = max(self.time, 1e-6 * us(deadline), deadline)
                return False
            at, data = self.coming.pop(0)
            self.time = 1e-6 * max(us(self.time), at)
            self.line.write_through(data)
        return True

    def writePort(self, packet):  # noqa: N802
        now_us, answer, coming = us(self.time), self.answer, self.coming
        self.answer, self.coming = lambda _: [], []
        count = super().writePort(packet)
        self.answer, frame = answer, self.sent_frames[-1]
        self.asked.append((now_us, frame))
        self.coming = sorted(coming + [(now_us + delay, data) for delay, data in answer(frame)])
        return count

    def rest(self, delay_us):
        """Let time pass; what comes then waits."""
        self.time = 1e-6 * (us(self.time) + delay_us)
        while self.coming and self.coming[0][0] <= us(self.time):
            self.line.write_through(self.coming.pop(0)[1])


class HostBus:
    """The host's bus, to be driven like the firmware's."""

    def __init__(self, bus, ids):
        self.bus = bus
        self.ids = ids

    @property
    def strays(self):
        return self.bus.port.strays

    def ping(self, servo):
        reply, model = self.bus.ping(servo)
        return said(reply)._replace(data=b""), model

    def read(self, *question):
        return said(self.bus.read(*question))

    def write(self, *question):
        return said(self.bus.write(*question))

    def sync_read(self, *question):
        return {servo: said(reply) for servo, reply in self.bus.sync_read(self.ids, *question).items()}

    def sync_write(self, address, data):
        size = len(data) // len(self.ids)
        self.bus.sync_write(address, {servo: data[n * size :][:size] for n, servo in enumerate(self.ids)})


def us(seconds):
    return round(1e6 * seconds)


def said(reply):
    return Said(reply.status, reply.data, reply.error, reply.alert, reply.late, us(reply.t))
