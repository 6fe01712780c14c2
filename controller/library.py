"""The compiled controller runtime, `libcontroller.so`: its structures and functions for ctypes."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_float, c_int16, c_int32, c_uint16, c_uint32, c_void_p
from functools import cache
from pathlib import Path
from typing import ClassVar, Final

from controller.errors import InputError
from controller.generate_runtime import fingerprint

PATH: Final = Path(__file__).resolve().parent / "libcontroller.so"
REMEDY: Final = "run `make setup`, or `pip install -e .` in the checkout"

OUTPUT_MAX: Final = 32
HEALTH_MAX: Final = 4


class SvProgram(ctypes.Structure):
    """Mirror `sv_program` of `runtime/sv_program.h`."""

    _fields_: ClassVar = [
        ("ninput", c_int32),
        ("nconst", c_int32),
        ("ninstruction", c_int32),
        ("nstate", c_int32),
        ("noutput", c_int32),
        ("constants", c_void_p),
        ("instructions", c_void_p),
        ("outputs", c_void_p),
    ]


class SvTerminal(ctypes.Structure):
    """Mirror `sv_terminal` of `runtime/sv_cycle.h`."""

    _fields_: ClassVar = [("kind", c_int16), ("channel", c_int16), ("zero", c_int32), ("scale", c_float)]


class SvOutput(ctypes.Structure):
    """Mirror `sv_output` of `runtime/sv_cycle.h`."""

    _fields_: ClassVar = [
        ("low", c_float),
        ("high", c_float),
        ("neutral", c_float),
        ("unit_scale", c_float),
        ("count_scale", c_float),
        ("zero", c_int32),
        ("count_low", c_int32),
        ("count_high", c_int32),
    ]


class SvGuard(ctypes.Structure):
    """Mirror `sv_guard` of `runtime/sv_cycle.h`."""

    _fields_: ClassVar = [("angle", SvTerminal), ("low", c_float), ("high", c_float)]


class SvCycle(ctypes.Structure):
    """Mirror `sv_cycle` of `runtime/sv_cycle.h`."""

    _fields_: ClassVar = [
        ("program", POINTER(SvProgram)),
        ("terminals", POINTER(SvTerminal)),
        ("outputs", POINTER(SvOutput)),
        ("guards", POINTER(SvGuard)),
        ("period_s", c_float),
        ("filter", c_float),
        ("slew_step", c_float),
        ("nraw", c_int32),
        ("x", SvTerminal),
        ("y", SvTerminal),
        ("heading", SvTerminal),
        ("facing", SvTerminal),
    ]


class SvGoal(ctypes.Structure):
    """Mirror `sv_goal` of `runtime/sv_cycle.h`."""

    _fields_: ClassVar = [("goal_dist", c_float), ("goal_bearing", c_float)]


class SvCycleState(ctypes.Structure):
    """Mirror `sv_cycle_state` of `runtime/sv_cycle.h`."""

    _fields_: ClassVar = [
        ("k", c_int32),
        ("goal_met", c_int32),
        ("goal_x", c_float),
        ("goal_y", c_float),
        ("held", c_float * OUTPUT_MAX),
    ]


class SvBlock(ctypes.Structure):
    """Mirror `sv_block` of `runtime/sv_schedule.h`."""

    _fields_: ClassVar = [("address", c_uint16), ("size", c_uint16)]


class SvSchedule(ctypes.Structure):
    """Mirror `sv_schedule` of `runtime/sv_schedule.h`."""

    _fields_: ClassVar = [
        ("nservo", c_int32),
        ("state", SvBlock),
        ("goal", SvBlock),
        ("nhealth", c_int32),
        ("health", SvBlock * HEALTH_MAX),
        ("health_every", c_int32),
    ]


class SvTransaction(ctypes.Structure):
    """Mirror `sv_transaction` of `runtime/sv_schedule.h`."""

    _fields_: ClassVar = [("kind", c_int32), ("servo", c_int32), ("block", POINTER(SvBlock))]


class SvAxis(ctypes.Structure):
    """Mirror `sv_axis` of `runtime/sv_homing.h`."""

    _fields_: ClassVar = [
        ("zero", c_int32),
        ("angle_scale", c_float),
        ("speed_scale", c_float),
        ("speed_max", c_float),
        ("neutral_rad", c_float),
        ("low_rad", c_float),
        ("high_rad", c_float),
        ("unlimited", c_int32),
    ]


@cache
def library() -> ctypes.CDLL:
    """Load the compiled runtime, once, and check that it belongs to this Python code.

    Raises:
        InputError: it is not built, does not load, or was built from other sources
    """
    if not PATH.exists():
        raise InputError(f"{PATH}: the controller library is not built; {REMEDY}")
    try:
        lib = ctypes.CDLL(str(PATH))
        _declare(lib)
    except (OSError, AttributeError) as error:
        raise InputError(f"{PATH}: the controller library does not load ({error}); {REMEDY}") from None
    if lib.sv_operations_fingerprint() != fingerprint():
        raise InputError(f"{PATH}: the controller library was built from another table of operations; {REMEDY}")
    if lib.sv_check_float() != 0:
        raise InputError(
            f"{PATH}: arithmetic in this process flushes subnormals or fuses; "
            "find the library that switched it (one linked with -ffast-math) and load it later"
        )
    return lib


def _declare(lib: ctypes.CDLL) -> None:
    """Declare arguments and results; a missing function raises AttributeError."""
    program = POINTER(SvProgram)
    cycle = POINTER(SvCycle)
    state = POINTER(SvCycleState)
    address = c_void_p
    lib.sv_operations_fingerprint.restype = c_uint32
    lib.sv_operations_fingerprint.argtypes = ()
    lib.sv_check_float.argtypes = ()
    lib.sv_verify.argtypes = (program,)
    lib.sv_run.argtypes = (program, c_float, c_int32, address, address, address, address)
    lib.sv_run.restype = None
    lib.sv_cycle_verify.argtypes = (cycle,)
    lib.sv_cycle_reset.argtypes = (cycle, state, address, address)
    lib.sv_cycle_reset.restype = None
    lib.sv_cycle_step.argtypes = (cycle, POINTER(SvGoal), state, *(address,) * 6)
    lib.sv_cycle_step.restype = None
    lib.sv_encode.argtypes = (POINTER(SvTerminal), c_float)
    lib.sv_encode.restype = c_int32
    lib.sv_schedule_due.argtypes = (POINTER(SvSchedule), c_int32, c_int32, POINTER(SvTransaction))
    axis = POINTER(SvAxis)
    lib.sv_homing_periods.argtypes = (c_float, c_int32, c_int32, c_float)
    lib.sv_homing_goal.argtypes = (c_int32,) * 4
    lib.sv_homing_near.argtypes = (axis, c_int32)
    lib.sv_homing_speed.argtypes = (axis, c_int32, c_float)
    lib.sv_speed_inside.argtypes = (axis, c_int32, c_int32, c_int32, c_int32)
    lib.sv_derate.argtypes = (c_int32, c_float)
