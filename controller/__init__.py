"""The ground that simulation, host loop and firmware share: programs, control cycle, servo products, rig files."""

from controller.products import PRODUCTS, Product
from controller.registers import Register, registers
from controller.rig import Rig
from controller.rig_file import load_rig, parse_rig, rig_names

__all__ = ["PRODUCTS", "Product", "Register", "Rig", "load_rig", "parse_rig", "registers", "rig_names"]
