"""Which virtual servo stands for which product, what it holds when a rig is new, and what its line speaks."""

from __future__ import annotations

from typing import Any, TypeAlias

from controller.products import Product
from controller.registers import registers
from controller.rig import Joint, Rig
from deploy.virtual.ax_servo import AxServo
from deploy.virtual.bus import Framing
from deploy.virtual.drive import Shaft
from deploy.virtual.dynamixel2_line import DYNAMIXEL2
from deploy.virtual.eeprom_file import Kept
from deploy.virtual.feetech_servo import FeetechServo
from deploy.virtual.protocol1_line import PROTOCOL1
from deploy.virtual.x_servo import XServo

VirtualServo: TypeAlias = XServo | AxServo | FeetechServo


def virtual_servo(product: Product, shaft: Shaft, kept: Kept) -> VirtualServo:
    """Return a servo.

    Args:
        product: which
        shaft: what it turns
        kept: what it holds where that is not the factory's
    """
    if product.family == "dynamixel-ax":
        return AxServo(product, shaft, kept.eeprom)
    if product.family.startswith("feetech"):
        return FeetechServo(product, shaft, kept.eeprom)
    return XServo(product, shaft, kept.eeprom, kept.backup)


def framing_of(rig: Rig) -> Framing[Any, Any]:
    """Return what a rig's servo line speaks.

    Args:
        rig: a rig with a bus
    """
    return DYNAMIXEL2 if rig.bus.protocol == "dynamixel-2.0" else PROTOCOL1


def commissioned(joint: Joint, rig: Rig) -> dict[str, int]:
    """Return what a servo's EEPROM holds once it has been set up for its rig, where that is not the factory's.

    Args:
        joint: the servo's joint
        rig: the rig

    Returns:
        register name => count
    """
    family, lines = joint.family, registers(joint.product)
    wanted = dict(family.settings) | dict(joint.gains)
    wanted |= {
        family.id: joint.id,
        family.baud_rate: next(value for value, rate in family.bauds.items() if rate == rig.bus.baud),
        family.return_delay: rig.bus.return_delay_us // 2,
        family.ceiling_limit: joint.ceiling,
    }
    if family.operating_mode is not None:
        wanted[family.operating_mode] = family.modes[joint.mode]
    return {name: count for name, count in wanted.items() if name in lines and lines[name].eeprom}
