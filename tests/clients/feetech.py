"""Drive an STS or SCS line through scservo_sdk, of either package: PORT, BAUD, `sts` or `scs`, id id ..."""

import sys
import time

import patience
import scservo_sdk as sdk
from patience import drained, tell

PATH, BAUD, SERIES = sys.argv[1], int(sys.argv[2]), sys.argv[3]
IDS = [int(word) for word in sys.argv[4:]]
STS = SERIES == "sts"
BAUDS = {1000000: 0, 500000: 1, 250000: 2, 115200: 4, 57600: 6}
OTHER = 500000
ID, RATE, DELAY, OFFSET, TORQUE, GOAL, POSITION = 5, 6, 7, 31, 40, 42, 56
LOCK = 55 if STS else 48
LEFT = 0x8000

port = sdk.PortHandler(PATH)


class Newer:
    """ftservo-python-sdk 2: the handler knows its port."""

    def __init__(self):
        self.handler = (sdk.sms_sts if STS else sdk.scscl)(port)
        self.word, self.group = self.handler.scs_makeword, self.handler
        self.low, self.high = self.handler.scs_lobyte, self.handler.scs_hibyte

    def __getattr__(self, name):
        return getattr(self.handler, name)

    def sync_read(self, address, size):
        return sdk.GroupSyncRead(self.handler, address, size)

    def sync_write(self, address, size):
        return sdk.GroupSyncWrite(self.handler, address, size)


class Older:
    """feetech-servo-sdk 1.0: the caller gives the port, and the byte order is the module's."""

    def __init__(self):
        self.handler = sdk.PacketHandler(0 if STS else 1)
        self.low, self.high = sdk.SCS_LOBYTE, sdk.SCS_HIBYTE

    def __getattr__(self, name):
        call = getattr(self.handler, name)
        return lambda *arguments: call(port, *arguments)

    def sync_read(self, address, size):
        return sdk.GroupSyncRead(port, self.handler, address, size)

    def sync_write(self, address, size):
        return sdk.GroupSyncWrite(port, self.handler, address, size)


bus = Newer() if hasattr(sdk, "sms_sts") else Older()


def drop():
    port.is_using = False
    port.ser.reset_input_buffer()


def until(ask, good, patience_s=patience.PATIENCE_S):
    return patience.until(ask, good, patience_s, drop)


def ok(answer):
    return answer[-2] == sdk.COMM_SUCCESS


def write(servo, address, value, size=1):
    call = {1: bus.write1ByteTxRx, 2: bus.write2ByteTxRx}[size]
    return until(lambda: call(servo, address, value), ok)[-1]


def read(servo, address, size=1):
    call = {1: bus.read1ByteTxRx, 2: bus.read2ByteTxRx}[size]
    return until(lambda: call(servo, address), ok)[0]


def present(servo):
    drop()
    return ok(bus.ping(servo))


def there(servo):
    return until(lambda: present(servo), bool)


def scan():
    found = {}
    for baud in BAUDS:
        assert port.setBaudRate(baud)
        rig = [servo for servo in IDS if (there(servo) if baud == BAUD else present(servo))]
        found[baud] = rig + [servo for servo in (0, 200) if present(servo)]
    assert port.setBaudRate(BAUD)
    return found


def model():
    return until(lambda: bus.ping(IDS[0]), ok)[0]


def change_id():
    servo, new = IDS[1], 42
    seen = [write(servo, LOCK, 0), write(servo, ID, new), there(new), present(servo), write(new, LOCK, 1)]
    write(new, LOCK, 0)
    return [*seen, write(new, ID, servo), there(servo), present(new), write(servo, LOCK, 1)]


def change_baud():
    servo = IDS[-1]
    write(servo, LOCK, 0)
    seen = [write(servo, RATE, BAUDS[OTHER])]
    assert port.setBaudRate(OTHER)
    seen += [there(servo), present(IDS[0]), write(servo, RATE, BAUDS[BAUD])]
    assert port.setBaudRate(BAUD)
    return [*seen, there(servo), write(servo, LOCK, 1)]


def move():
    starts = [read(servo, POSITION, 2) for servo in IDS]
    goals = [start + 30 for start in starts]
    write(IDS[0], GOAL, starts[0], 2)
    torque = read(IDS[0], TORQUE)
    for servo, start in zip(IDS, starts, strict=True):
        write(servo, GOAL, start, 2)
        write(servo, TORQUE, 1)
    together = bus.sync_write(GOAL, 2)
    for servo, goal in zip(IDS, goals, strict=True):
        together.addParam(servo, [bus.low(goal), bus.high(goal)])
    together.txPacket()
    away = until(
        lambda: [abs(read(servo, POSITION, 2) - goal) for servo, goal in zip(IDS, goals, strict=True)],
        lambda now: max(now) < 25,
    )
    return [torque, max(away) < 25, [read(servo, GOAL, 2) for servo in IDS] == goals]


def sync_read():
    group = bus.sync_read(POSITION, 2)
    for servo in IDS:
        group.addParam(servo)
    result = until(lambda: [group.txRxPacket()], lambda answer: answer[0] == sdk.COMM_SUCCESS)[0]
    return [result, [group.getData(servo, POSITION, 2) for servo in IDS]]


def register_and_act():
    goal = read(IDS[0], POSITION, 2)
    limit = 48 if STS else GOAL
    value = 700 if STS else goal
    until(lambda: bus.regWriteTxRx(IDS[0], limit, 2, [bus.low(value), bus.high(value)]), ok)
    before = read(IDS[0], limit, 2)
    bus.action(254)
    drained(drop)
    after = until(lambda: read(IDS[0], limit, 2), lambda held: held == value)
    if STS:
        write(IDS[0], limit, 1000, 2)
    return [before == value, after == value]


def rehome():
    """128 to torque enable makes the present position the middle."""
    servo = IDS[0]
    write(servo, LOCK, 0)
    write(servo, TORQUE, 0)
    at_rest(servo)
    before = read(servo, OFFSET, 2)
    write(servo, TORQUE, 128)
    middle = until(lambda: read(servo, POSITION, 2), lambda held: abs(held - 2048) < 20, 5.0)
    return [before, middle, read(servo, OFFSET, 2)]


def at_rest(servo):
    """Wait until a limp joint hangs still; return where."""
    last = None
    for _ in range(100):
        last, before = read(servo, POSITION, 2), last
        if last == before:
            break
        time.sleep(0.3)
    return last


def calibrate():
    """Put a joint's middle where it is, as LeRobot does: offset and limits cleared, offset from the half turn."""
    servo = IDS[1]
    seen = [write(servo, TORQUE, 0), write(servo, LOCK, 0), write(servo, OFFSET, 0, 2)]
    seen += [write(servo, 9, 0, 2), write(servo, 11, 4095, 2)]
    here = at_rest(servo)
    offset = here - 2047
    seen.append(write(servo, OFFSET, offset if offset >= 0 else -offset | 1 << 11, 2))
    middle = read(servo, POSITION, 2)
    seen += [write(servo, 9, 1000, 2), write(servo, 11, 3000, 2)]
    seen += [write(servo, DELAY, 0), write(servo, 85, 254), write(servo, 41, 254), write(servo, 33, 0)]
    phase = read(servo, 18)
    seen += [write(servo, 18, phase & ~0x10), write(servo, 21, 16), write(servo, 22, 32), write(servo, 23, 0)]
    seen += [write(servo, TORQUE, 1), write(servo, LOCK, 1)]
    return [seen, middle, read(servo, 21)]


def health():
    return [[read(servo, 60, 2) & ~0x400, read(servo, 62), read(servo, 63)] for servo in IDS]


def main():
    seen = {"scan": scan(), "model": model(), "id": change_id(), "baud": change_baud(), "move": move()}
    seen |= {"health": health(), "act": register_and_act()}
    if STS:
        seen |= {"sync_read": sync_read(), "rehome": rehome(), "calibrate": calibrate()}
    for servo in IDS:
        write(servo, TORQUE, 0)
    seen["torque"] = [read(servo, TORQUE) for servo in IDS]
    tell(seen)


main()
