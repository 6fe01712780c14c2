"""A generated rig, compiled and read back: the structures of `sv_rig.h` as ctypes has them."""

import ctypes
import subprocess
from ctypes import POINTER, c_char, c_float, c_int32, c_uint8, c_uint16, c_uint32

from controller.generate_runtime import PATH as RUNTIME_TABLE
from controller.library import SvAxis, SvBlock
from firmware_gen.projects.project import RUNTIME
from firmware_gen.projects.rig_config import rig_header, rig_source
from firmware_gen.projects.rig_sizes import sizes_files, sizes_of
from firmware_gen.transpiler.unit import make_unit

FLAGS = (
    *("-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion"),
    *("-Wdouble-promotion", "-Wmissing-prototypes", "-Werror"),
)


class SvRegister(ctypes.Structure):
    _fields_ = (("address", c_uint16), ("size", c_uint8), ("encoding", c_uint8))


class SvSetting(ctypes.Structure):
    _fields_ = (("reg", SvRegister), ("value", c_uint16))


class SvCheck(ctypes.Structure):
    _fields_ = (("reg", SvRegister), ("low", c_uint16), ("high", c_uint16), ("mask", c_uint8), ("kind", c_uint8))


class SvServo(ctypes.Structure):
    _fields_ = (
        ("model", c_uint16),
        ("error_bits", c_uint8),
        ("jump_counts", c_float),
        ("counts_per_us", c_float),
        *((name, c_uint32) for name in ("tracking_counts", "slew_counts", "homing_counts")),
        ("voltage_low", c_int32),
        ("rest_count", c_int32),
        ("ceiling_count", c_int32),
        *((name, SvRegister) for name in ("position", "velocity", "load", "goal", "torque", "ceiling", "watchdog")),
        *((name, SvRegister) for name in ("hardware_error", "shutdown", "voltage", "temperature")),
        ("tables", SvBlock * 2),
        ("checks", POINTER(SvCheck)),
        ("ncheck", c_int32),
        ("settings", POINTER(SvSetting)),
        ("nsetting", c_int32),
    )


class SvJoint(ctypes.Structure):
    _fields_ = (
        ("id", c_uint8),
        ("servo", c_uint8),
        ("zero", c_int32),
        ("angle_scale", c_float),
        ("goal_low", c_int32),
        ("goal_high", c_int32),
        ("place_low", c_int32),
        ("place_high", c_int32),
        ("neutral", c_int32),
    )


class SvSensor(ctypes.Structure):
    _fields_ = (
        ("message", c_uint8),
        ("field", c_uint8),
        ("needed", c_uint8),
        ("zero", c_int32),
        ("scale", c_float),
        ("age_us_max", c_int32),
    )


class SvMessage(ctypes.Structure):
    _fields_ = (("letter", c_char), ("width", c_uint8), ("latency_us", c_int32))


class SvSafety(ctypes.Structure):
    _fields_ = (
        ("stop_holds", c_uint8),
        ("homing_rad_s", c_float),
        ("tracking_rad_max", c_float),
        ("tracking_us_max", c_int32),
        ("missed_max", c_int32),
        ("temperature_max", c_int32),
        ("tilt_cosine_min", c_float),
        ("overrun_max", c_int32),
        ("watchdog_us", c_int32),
        ("watchdog_count", c_int32),
    )


class SvRig(ctypes.Structure):
    _fields_ = (
        ("protocol", c_int32),
        ("baud", c_int32),
        ("return_delay_us", c_int32),
        ("patience_us", c_int32),
        ("velocity_mode", c_uint8),
        ("fast_sync_read", c_uint8),
        ("period_us", c_int32),
        ("homing_periods_max", c_int32),
        ("njoint", c_int32),
        ("joints", POINTER(SvJoint)),
        ("servos", POINTER(SvServo)),
        ("axes", POINTER(SvAxis)),
        ("nsensor", c_int32),
        ("sensors", POINTER(SvSensor)),
        ("nmessage", c_int32),
        ("messages", POINTER(SvMessage)),
        ("roll", c_int32),
        ("pitch", c_int32),
        ("safety", SvSafety),
        ("fingerprint", c_uint32),
    )


def rig_in_c(folder, rig, controller):
    """Compile a rig's data into a library of its own; return its `sv_rig` and the library."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.c").write_text(rig_source(rig, controller))
    (folder / "rig.h").write_text(rig_header(rig, make_unit(controller, "unit")))
    for name, text in sizes_files(sizes_of(rig, controller), rig).items():
        (folder / name).write_text(text)
    # the sizes of this rig, the structures of all
    paths = [f"-I{path}" for path in (folder, RUNTIME, RUNTIME_TABLE.parent)]
    sources = [str(folder / "rig.c"), str(RUNTIME / "sv_rig.c")]
    command = ["gcc", *FLAGS, "-shared", "-fPIC", *paths, "-o", str(folder / "rig.so"), *sources]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(folder / "rig.so"))
    return SvRig.in_dll(library, "servolve_rig"), library
