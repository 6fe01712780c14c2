"""Drive an X or AX line through dynamixel_sdk, whichever version is installed: PORT, BAUD, PROTOCOL, id id ..."""

import sys
import time

import dynamixel_sdk as sdk
import patience
from patience import drained, tell

PATH, BAUD, PROTOCOL = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
IDS = [int(word) for word in sys.argv[4:]]
X = PROTOCOL == 2.0
ID, RATE, DELAY, TORQUE = (7, 8, 9, 64) if X else (3, 4, 5, 24)
GOAL, POSITION, WIDTH = (116, 132, 4) if X else (30, 36, 2)
BAUDS = {9600: 0, 57600: 1, 115200: 2, 1000000: 3, 2000000: 4} if X else {57600: 34, 115200: 16, 1000000: 1}
OTHER = 57600

port, packets = sdk.PortHandler(PATH), sdk.PacketHandler(PROTOCOL)


def drop():
    port.is_using = False
    port.ser.reset_input_buffer()


def until(ask, good, patience_s=patience.PATIENCE_S):
    return patience.until(ask, good, patience_s, drop)


def ok(answer):
    return answer[-2] == sdk.COMM_SUCCESS


def write(servo, address, value, size=1):
    """Return the status error of a write; a repeated write of the same value does no harm."""
    call = {1: packets.write1ByteTxRx, 2: packets.write2ByteTxRx, 4: packets.write4ByteTxRx}[size]
    return until(lambda: call(port, servo, address, value), ok)[-1]


def read(servo, address, size=1):
    call = {1: packets.read1ByteTxRx, 2: packets.read2ByteTxRx, 4: packets.read4ByteTxRx}[size]
    return until(lambda: call(port, servo, address), ok)[0]


def present(servo):
    drop()
    return ok(packets.ping(port, servo))


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


def change_id():
    servo, new = IDS[1], 42
    seen = [write(servo, ID, new), there(new), present(servo)]
    return [*seen, write(new, ID, servo), there(servo), present(new)]


def change_baud():
    servo = IDS[-1]
    seen = [write(servo, RATE, BAUDS[OTHER])]
    assert port.setBaudRate(OTHER)
    seen += [there(servo), present(IDS[0]), write(servo, RATE, BAUDS[BAUD])]
    assert port.setBaudRate(BAUD)
    return [*seen, there(servo)]


def eeprom_with_torque_on():
    before = read(IDS[0], DELAY)
    write(IDS[0], TORQUE, 1)
    refused = write(IDS[0], DELAY, 20)
    kept = read(IDS[0], DELAY) == before
    write(IDS[0], TORQUE, 0)
    accepted = write(IDS[0], DELAY, 20)
    changed = read(IDS[0], DELAY)
    write(IDS[0], DELAY, before)
    return [refused, kept, accepted, changed]


def goal_bytes(value):
    return list(int(value).to_bytes(WIDTH, "little"))


def move():
    """Move all a little by sync write; read back together where the protocol can."""
    starts = [read(servo, POSITION, WIDTH) for servo in IDS]
    goals = [start + 30 for start in starts]
    for servo, start in zip(IDS, starts, strict=True):
        write(servo, GOAL, start, WIDTH)
        write(servo, TORQUE, 1)
    together = sdk.GroupSyncWrite(port, packets, GOAL, WIDTH)
    for servo, goal in zip(IDS, goals, strict=True):
        together.addParam(servo, goal_bytes(goal))
    together.txPacket()
    near = until(
        lambda: [abs(read(servo, POSITION, WIDTH) - goal) for servo, goal in zip(IDS, goals, strict=True)],
        lambda away: max(away) < 25,
    )
    return [max(near) < 25, [read(servo, GOAL, WIDTH) for servo in IDS] == goals]


def sync_reads(fast):
    group = sdk.GroupSyncRead(port, packets, POSITION, WIDTH)
    for servo in IDS:
        group.addParam(servo)
    ask = group.fastSyncRead if fast else group.txRxPacket
    result = until(lambda: [ask()], lambda answer: answer[0] == sdk.COMM_SUCCESS)[0]
    return [result, [group.getData(servo, POSITION, WIDTH) for servo in IDS]]


def bulk_read():
    group = sdk.GroupBulkRead(port, packets)
    group.addParam(IDS[0], POSITION, 4)
    group.addParam(IDS[1], 146, 1)
    result = until(lambda: [group.txRxPacket()], lambda answer: answer[0] == sdk.COMM_SUCCESS)[0]
    return [result, group.getData(IDS[0], POSITION, 4), group.getData(IDS[1], 146, 1)]


def bulk_write():
    group = sdk.GroupBulkWrite(port, packets)
    group.addParam(IDS[0], 65, 1, [1])
    group.addParam(IDS[1], 84, 2, [0x34, 0x02])
    group.txPacket()
    return [read(IDS[0], 65), read(IDS[1], 84, 2)]


def register_and_act():
    address = 65 if X else 25
    until(lambda: packets.regWriteTxRx(port, IDS[0], address, 1, [1]), ok)
    registered = read(IDS[0], 69 if X else 44)
    before = read(IDS[0], address)
    packets.action(port, IDS[0] if X else 254)
    drained(drop)
    after = until(lambda: read(IDS[0], address), lambda value: value == 1)
    write(IDS[0], address, 0)
    return [registered, before, after]


def at_rest(servo):
    """Wait until a limp joint hangs still; return where."""
    last = None
    for _ in range(100):
        last, before = read(servo, POSITION, WIDTH), last
        if last == before:
            break
        time.sleep(0.3)
    return last


def calibrate():
    """Put a joint's middle where it is, as LeRobot does: extended position, offset from the half turn, then limits."""
    servo = IDS[0]
    write(servo, TORQUE, 0)
    seen = [write(servo, 11, 4), write(servo, 20, 0, 4), write(servo, 48, 4095, 4), write(servo, 52, 0, 4)]
    here = at_rest(servo)
    seen.append(write(servo, 20, (2047 - here) & 0xFFFFFFFF, 4))
    middle = read(servo, POSITION, 4)
    seen += [write(servo, 52, 1000, 4), write(servo, 48, 3000, 4)]
    return [seen, middle]


def reboot():
    write(IDS[0], TORQUE, 1)
    packets.reboot(port, IDS[0])
    time.sleep(0.5)
    drained(drop)
    return [there(IDS[0]), read(IDS[0], TORQUE)]


def health():
    if X:
        return [[read(servo, 126, 2), read(servo, 144, 2), read(servo, 146)] for servo in IDS]
    return [[read(servo, 40, 2), read(servo, 42), read(servo, 43)] for servo in IDS]


def main():
    seen = {"scan": scan(), "id": change_id(), "baud": change_baud(), "eeprom": eeprom_with_torque_on()}
    seen |= {"move": move(), "health": health(), "act": register_and_act()}
    if X:
        seen |= {"sync_read": sync_reads(False), "bulk_read": bulk_read(), "bulk_write": bulk_write()}
        if hasattr(sdk.GroupSyncRead, "fastSyncRead"):
            seen["fast_sync_read"] = sync_reads(True)
        seen |= {"calibrate": calibrate(), "reboot": reboot()}
    for servo in IDS:
        write(servo, TORQUE, 0)
    seen["torque"] = [read(servo, TORQUE) for servo in IDS]
    tell(seen)


main()
