"""Change registers that servos keep without power: one at a time, torque off, each read back.

EEPROM wears and outlives the program, so nothing here decides what to change: it carries out what a person has agreed
to, after a backup is on the disk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from controller.errors import InputError, RunError
from controller.families import Family, family_of
from controller.products import PRODUCTS, Product
from controller.registers import encode_register, registers
from controller.rig import Rig
from deploy.buses.port import BITS_PER_BYTE, PortLostError
from deploy.buses.servo_bus import BusError, ServoBus
from deploy.buses.table_reader import read_table
from deploy.commissioning.servo_backup import ServoBackup
from deploy.finding import Fix


def find_baud(bus: ServoBus, rig: Rig, servo: int, product: Product) -> int | None:
    """Look for a servo that does not answer at its rig's bit rate at all others that it can be set to.

    Args:
        bus: the rig's bus, which is at the rig's bit rate again afterwards
        rig: the rig
        servo: its id
        product: what it should be

    Returns:
        the bit rate at which this product answers, or None [bits/s]
    """
    family, table = family_of(product), registers(product)
    for value, baud in family.bauds.items():
        if baud == rig.bus.baud:
            continue
        with _at_baud(bus, baud, rig.bus.baud) as offered:
            if not offered or all(bus.ping(servo)[1] != product.model_number for _ in range(2)):
                continue
            with suppress(BusError):  # what came was a late answer to an earlier question, or noise
                if bus.read_register(servo, table[family.baud_rate]) == value:
                    return baud
    return None


def read_backup(bus: ServoBus, rig: Rig, servo: int, product: Product, baud: int) -> ServoBackup:
    """Read every register of a servo.

    Args:
        bus: the rig's bus
        rig: the rig
        servo: its id
        product: what it is
        baud: bit rate at which it answers [bits/s]

    Raises:
        BusError: it can not be read
    """
    with _at_baud(bus, baud, rig.bus.baud):
        return ServoBackup(servo, product.name, baud, read_table(bus, servo, product))


def restoring(backup: ServoBackup, now: Mapping[str, int]) -> list[Fix]:
    """Return what to change so that a servo's EEPROM holds what it held.

    Args:
        backup: what it held
        now: what it holds: register name => count

    Raises:
        InputError: it is another servo than that of the backup
    """
    product = PRODUCTS[backup.product]
    table = registers(product)
    model = family_of(product).model_number
    if backup.values.get(model) != now[model]:
        raise InputError(f"servo {backup.id} is not the {backup.product} of the backup; connect that one")
    return [
        Fix(backup.id, name, now[name], value, "as it was")
        for name, value in backup.values.items()
        if table[name].eeprom and table[name].access == "rw" and now[name] != value
    ]


def apply_fixes(
    bus: ServoBus, rig: Rig, servos: Sequence[ServoBackup], fixes: Sequence[Fix], told: Callable[[Fix], None]
) -> None:
    """Change registers, servo by servo and register by register; the bit rate last.

    Each servo's torque goes off first, and stays off. A Feetech servo's lock is open while its registers are written,
    and closed again on every way out.

    Args:
        bus: the rig's bus, which is at the rig's bit rate again afterwards
        rig: the rig
        servos: what they held before, as the backup has it
        fixes: what to change
        told: called after each change that was read back

    Raises:
        RunError: a servo did not take a change; says how far it went
    """
    done = 0

    def count(fix: Fix) -> None:
        nonlocal done
        done += 1
        told(fix)

    for servo in servos:
        mine = [fix for fix in fixes if fix.servo == servo.id]
        if not mine:
            continue
        try:
            with _at_baud(bus, servo.baud, rig.bus.baud):
                _change_servo(bus, servo, mine, count)
        except (BusError, PortLostError) as error:
            raise RunError(f"{error} ({done} of {len(fixes)} changes were made before)") from None


def _change_servo(bus: ServoBus, servo: ServoBackup, fixes: Sequence[Fix], told: Callable[[Fix], None]) -> None:
    product = PRODUCTS[servo.product]
    family, table = family_of(product), registers(product)
    bus.write_register(servo.id, table[family.torque_enable], 0)
    with _unlocked(bus, servo.id, product, family):
        for fix in fixes:
            if fix.register != family.baud_rate:
                bus.write_register(servo.id, table[fix.register], fix.want)
                told(fix)
        for fix in fixes:
            if fix.register == family.baud_rate:
                _change_baud(bus, servo.id, product, fix.want)
                told(fix)


def _change_baud(bus: ServoBus, servo: int, product: Product, value: int) -> None:
    """Write the bit rate, which the servo answers at the old one, and follow it to the new one."""
    family = family_of(product)
    register = registers(product)[family.baud_rate]
    bus.write(servo, register.address, encode_register(register, value))
    bus.port.setupPort(family.bauds[value])
    held = bus.read_register(servo, register)
    if held != value:
        raise BusError(f"servo {servo}: {register.name} reads {held} after {value} was written; try again")


@contextmanager
def _unlocked(bus: ServoBus, servo: int, product: Product, family: Family) -> Iterator[None]:
    """Let a Feetech servo keep what is written; the lock of an AX servo would last until power is cut."""
    if family.protocol != "feetech" or family.lock is None:
        yield
        return
    lock = registers(product)[family.lock]
    try:
        bus.write_register(servo, lock, 0)
        yield
    except BaseException:
        with suppress(BusError, PortLostError):
            bus.write_register(servo, lock, 1)
        raise
    bus.write_register(servo, lock, 1)


@contextmanager
def _at_baud(bus: ServoBus, baud: int, afterwards: int) -> Iterator[bool]:
    """Talk at another bit rate for a while; give whether the port offers it."""
    offered = True
    if baud != afterwards:
        try:
            bus.port.setupPort(baud)
        except InputError:
            offered = False
    try:
        yield offered
    finally:
        if bus.port.byte_s != BITS_PER_BYTE / afterwards:
            with suppress(InputError):
                bus.port.setupPort(afterwards)
