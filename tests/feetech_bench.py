"""STS3215 and SCS0009 servos on a bench with motors of their own, and what their manuals call their registers."""

from controller.products import PRODUCTS
from tests.motor_bench import Bench

STS, SCS = PRODUCTS["sts3215"], PRODUCTS["scs0009"]
# addresses: Feetech's memory table of the ST3215; the SCS's: SCS0009 memory table
ID, BAUD, DELAY, LEVEL, MIN, MAX, PHASE, UNLOAD, P, OFFSET, MODE = 5, 6, 7, 8, 9, 11, 18, 19, 21, 31, 33
TORQUE, ACCELERATION, GOAL, TIME, SPEED, LIMIT, LOCK = 40, 41, 42, 44, 46, 48, 55
PRESENT, PRESENT_SPEED, LOAD, VOLTAGE, TEMPERATURE, ASYNC, STATUS, MOVING, CURRENT = 56, 58, 60, 62, 63, 64, 65, 66, 69
OVERLOAD = 0x20


def sts(*ids, ticks=2048.0, **eeprom):
    return Bench(*((STS, {"id": i, **eeprom}, ticks) for i in ids or (1,)))


def scs(**eeprom):
    return Bench((SCS, {"id": 1, **eeprom}, 512.0))


def signed(word, bit=15):
    return -(word & ((1 << bit) - 1)) if word >> bit & 1 else word & ((1 << bit) - 1)


def place(bench, servo=1):
    return signed(bench.read(servo, PRESENT, 2))


def power_cycle(bench):
    for servo in bench.servos:
        servo.power_off()
        servo.reboot(bench.now_ns)
    bench.wait(0.5)
