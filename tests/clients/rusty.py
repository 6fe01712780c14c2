"""Drive a line through rustypot: PORT, BAUD, the controller's name, id id ..."""

import sys

import rustypot
from patience import tell, until

PATH, BAUD, NAME = sys.argv[1], int(sys.argv[2]), sys.argv[3]
IDS = [int(word) for word in sys.argv[4:]]
X, STS, SCS = NAME.startswith("Xl"), NAME.startswith("Sts"), NAME.startswith("Scs")
RATE = {"Xl": (1, 3), "St": (1, 0), "Sc": (1, 0), "Ax": (16, 1)}[NAME[:2]]  # register counts of OTHER and of BAUD
OTHER = {"Xl": 57600, "St": 500000, "Sc": 500000, "Ax": 115200}[NAME[:2]]
DELAY = 9 if X else 7 if STS or SCS else 5

bus = getattr(rustypot, NAME)(PATH, BAUD, 1.0)


def one(name, servo, *value):
    """Call an accessor of one servo; rustypot gives lists."""
    answer = until(lambda: getattr(bus, name)(servo, *value), lambda _: True)
    return answer[0] if isinstance(answer, list) else answer


def lock(servo, closed):
    if STS or SCS:
        one("write_raw_lock", servo, int(closed))


def silent(servo):
    bus.set_timeout(0.05)
    try:
        return not bus.ping(servo)
    except (OSError, RuntimeError):
        return True
    finally:
        bus.set_timeout(1.0)


def there(servo):
    return until(lambda: bus.ping(servo), bool) is True


def scan():
    found = until(lambda: bus.scan([*IDS, 99]), lambda answer: len(answer) == len(IDS))
    return [sorted(found), sorted(set(found.values()))]


def broadcast():
    found = until(lambda: bus.broadcast_scan([*IDS, 99]), lambda answer: len(answer) == len(IDS))
    return sorted(found)


def change_id():
    servo, new = IDS[1], 42
    lock(servo, False)
    one("write_id", servo, new)
    seen = [there(new), silent(servo)]
    one("write_id", new, servo)
    return [*seen, there(servo)]


def change_baud():
    servo = IDS[-1]
    name = "write_baud_rate" if hasattr(bus, "write_baud_rate") else "write_baudrate"
    lock(servo, False)
    one(name, servo, RATE[0])
    bus.set_baudrate(OTHER)
    seen = [there(servo), silent(IDS[0])]
    one(name, servo, RATE[1])
    bus.set_baudrate(BAUD)
    return [*seen, there(servo)]


def torque(servo, on):
    one("write_torque_enable", servo, bool(on))


def eeprom_with_torque_on():
    before = one("read_return_delay_time", IDS[0])
    torque(IDS[0], True)
    try:
        told = bus.write_raw_data_with_error(IDS[0], DELAY, [20])
    except RuntimeError as error:
        told = str(error)
    held = one("read_return_delay_time", IDS[0])
    torque(IDS[0], False)
    return [held == before, repr(told)]


def positions():
    """Read angles [rad], together where the protocol can."""
    if X or STS:
        return until(lambda: bus.sync_read_present_position(IDS), lambda now: len(now) == len(IDS))
    return [one("read_present_position", servo) for servo in IDS]


def move():
    starts = positions()
    goals = [start + 0.05 for start in starts]
    for servo, start in zip(IDS, starts, strict=True):
        one("write_goal_position", servo, start)
        torque(servo, True)
    if hasattr(bus, "sync_write_goal_position"):
        until(lambda: bus.sync_write_goal_position(IDS, goals), lambda _: True)
    else:
        for servo, goal in zip(IDS, goals, strict=True):
            one("write_goal_position", servo, goal)
    away = until(
        lambda: [abs(now - goal) for now, goal in zip(positions(), goals, strict=True)], lambda far: max(far) < 0.04
    )
    return max(away) < 0.04


def fast_read():
    bus.set_fast_sync_read(True)
    angles = positions()
    bus.set_fast_sync_read(False)
    return [len(angles), max(abs(a - b) for a, b in zip(angles, positions(), strict=True)) < 0.01]


def health():
    volts = "read_present_input_voltage" if X else "read_present_voltage"
    load = "read_present_current" if X else "read_present_load"
    return [[one(load, servo), one(volts, servo), one("read_present_temperature", servo)] for servo in IDS]


def main():
    seen = {"scan": scan(), "id": change_id(), "baud": change_baud(), "eeprom": eeprom_with_torque_on()}
    seen |= {"move": move(), "health": health()}
    if X:
        seen |= {"broadcast": broadcast(), "fast": fast_read()}
    for servo in IDS:
        torque(servo, False)
    seen["torque"] = [int(one("read_torque_enable", servo)) for servo in IDS]
    tell(seen)


main()
