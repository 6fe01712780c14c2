"""What random masters of every protocol have in common: a virtual line, its bytes, and the values they try."""

from hypothesis.stateful import RuleBasedStateMachine

from deploy.virtual.rig import VirtualRig


class LineMaster(RuleBasedStateMachine):
    """A master on one line, with what it knows of each servo."""

    def __init__(self, rig):
        super().__init__()
        self.rig = VirtualRig(rig)
        self.baud = rig.bus.baud
        self.t = 0.0
        self.servos = []

    def send(self, data):
        """Send bytes; return all that comes back."""
        self.t = self.rig.transmit(data, max(self.t, self.rig.now) + 1e-4)
        self.sent()
        replies = b""
        while (event := self.rig.next_event()) is not None:
            replies += b"".join(reply for _, reply in self.rig.replies_until(event))
            self.t = event
        return replies

    def sent(self):
        """Note that bytes have left."""

    def hears(self, servo):
        return servo.baud == self.baud

    @staticmethod
    def value(item, kind, number):
        """Return a value for an item, as it would be read back."""
        value = {
            "low": item.low,
            "high": item.high,
            "below": item.low - 1,
            "above": item.high + 1,
            "within": item.low + number % (item.high - item.low + 1),
            "initial": item.initial or 0,
        }[kind]
        return item.decode(item.encode(value))
