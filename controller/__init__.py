"""The ground that simulation, host loop and firmware share: programs, control cycle, servo products, rig files."""

from controller.canonical import program_hash
from controller.controller import Controller, Input, Output
from controller.controller_file import controller_text, load_controller, parse_controller, save_controller
from controller.lowering import lower, lower_outputs
from controller.products import PRODUCTS, Product
from controller.program import Program
from controller.registers import Register, registers
from controller.rig import Rig
from controller.rig_file import load_rig, parse_rig, rig_names
from controller.source import Source
from controller.text import format_source, parse
from controller.verifier import verify

__all__ = [
    "PRODUCTS",
    "Controller",
    "Input",
    "Output",
    "Product",
    "Program",
    "Register",
    "Rig",
    "Source",
    "controller_text",
    "format_source",
    "load_controller",
    "load_rig",
    "lower",
    "lower_outputs",
    "parse",
    "parse_controller",
    "parse_rig",
    "program_hash",
    "registers",
    "rig_names",
    "save_controller",
    "verify",
]
