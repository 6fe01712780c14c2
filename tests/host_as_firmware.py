"""The host loop as firmware: it waits in its thread until the bench wakes it, and knows the rig by bytes alone."""

import math
import queue
import threading

from controller.errors import RunError
from deploy.buses.open_bus import open_bus
from deploy.buses.port import SerialPort
from deploy.firmware.machine import Given, Taken
from deploy.host_loop import run_controller
from deploy.logs.log import RunLog
from deploy.period import Connection


def microseconds(t):
    """Return a time in whole microseconds, rounded up; what is one but for a float's last bits stays."""
    return math.ceil(round(t * 1e6, 3))


class WirePort(SerialPort):
    """A port whose bytes come and go with a machine's waits."""

    def __init__(self, machine, baud):
        self.machine = machine
        super().__init__("/dev/null", baud)
        self.label = "firmware"
        self.latency_s = 0.001

    def setupPort(self, cflag_baud):  # noqa: N802
        self.is_open = True
        self.byte_s = 10 / cflag_baud
        return True

    def closePort(self):  # noqa: N802
        self.is_open = False
        self._lock.close()

    def now(self):
        return self.machine.now()

    def waiting(self, for_s=0.0):
        return bool(self.machine.bus)

    def wait(self, deadline):
        while not self.waiting():
            if self.now() >= deadline:
                return False
            self.machine.wait(deadline)
        return True

    def expect(self, nbyte, nreply, return_delay_s):
        super().expect(nbyte, nreply, return_delay_s)
        self._deadline = microseconds(self._deadline) * 1e-6

    def _take(self):
        data, self.machine.bus = self.machine.bus, b""
        self._received += data
        self._received_at = self.now()
        self._buffer += data

    def writePort(self, packet):  # noqa: N802
        frame = self.sent = bytes(packet)
        if self.tap:
            self.tap("tx", self.now(), frame)
        self.machine.sent.append(frame)
        self._line_free = max(self._line_free, self.now()) + len(frame) * self.byte_s
        return len(frame)


class HostAsFirmware:
    """Run the host loop in a thread that works only while the bench waits for it."""

    def __init__(self, rig, controller, options, log):
        self.bus = self.sensors = b""
        self.sent = []
        self.outcome = None
        self._given, self._taken = queue.Queue(), queue.Queue()
        self._now_us = 0
        self._arguments = (rig, controller, options, log)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._closed = False

    # what the bench calls

    def resume(self, given):
        if not self._thread.is_alive():
            if self.outcome is not None:
                raise RunError("the run is over")
            self._now_us, self.bus, self.sensors = given.now_us, given.bus, given.sensors
            self._thread.start()
        else:
            self._given.put(given)
        return self._taken.get(timeout=30)

    def close(self):
        self._closed = True
        self._given.put(None)
        if self._thread.is_alive():
            self._thread.join(30)

    # what the loop calls

    def now(self):
        return self._now_us * 1e-6

    def sleep_until(self, t):
        while self.now() < t - 1e-9:
            self.wait(t)

    def wait(self, until):
        if self._closed:
            raise SystemExit
        sent, self.sent = tuple(self.sent), []
        self._taken.put(Taken(microseconds(until), sent))
        given = self._given.get(timeout=30)
        if given is None:
            raise SystemExit
        assert isinstance(given, Given)
        self._now_us = given.now_us
        self.bus += given.bus
        self.sensors += given.sensors

    def read_available(self):
        data, self.sensors = self.sensors, b""
        return data

    def _run(self):
        rig, controller, options, log = self._arguments
        try:
            with RunLog(log) as record:
                link = Connection(open_bus(WirePort(self, rig.bus.baud), rig), self, self, None, lambda: None)
                try:
                    self.outcome = run_controller(link, rig, controller, options, record)
                finally:
                    link.bus.close()
        finally:
            self._taken.put(Taken(self._now_us, tuple(self.sent), b"over"))
