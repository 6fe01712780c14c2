"""A servo port over a real pseudo terminal with a script at its other end, for tests of what the SDKs do with bytes."""

import pytest

from deploy.buses.port import SerialPort
from deploy.virtual.pty_line import PtyLine

BAUD = 1_000_000


class ScriptedPort(SerialPort):
    """The port over a real pseudo terminal, with a script at the other end and time that only waiting moves."""

    def __init__(self, answer):
        self.line = PtyLine()
        self.time = 0.0
        self.answer = answer
        self.sent_frames = []
        self.coming = []
        super().__init__(self.line.path, BAUD)
        self.latency_s = 0.002

    def now(self):
        return self.time

    def wait(self, deadline):
        while not self.waiting():
            if not self.coming or self.coming[0][0] > deadline:
                self.time = max(self.time, deadline)
                return False
            at, data = self.coming.pop(0)
            self.time = max(self.time, at)
            self.line.write_through(data)
        return True

    def writePort(self, packet):  # noqa: N802
        count = super().writePort(packet)
        frame = self.line.read(count)
        self.sent_frames.append(frame)
        self.coming = sorted(self.coming + [(self.time + delay, data) for delay, data in self.answer(frame)])
        return count

    def closePort(self):  # noqa: N802
        super().closePort()
        self.line.close()


def replies(*frames, delay=1e-4):
    """Answer every question with the same frames."""
    return lambda _: [(delay, b"".join(frames))]


@pytest.fixture
def scripted():
    """Return a function that opens a port whose other end answers as told; the ports are closed afterwards."""
    ports = []

    def open_port(answer):
        ports.append(ScriptedPort(answer))
        return ports[-1]

    yield open_port
    for port in ports:
        port.closePort()
