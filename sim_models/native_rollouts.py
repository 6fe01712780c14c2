"""The compiled rollouts, `librollouts.so`: its structures and functions, and MuJoCo's batch, for ctypes."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_char_p, c_double, c_float, c_int, c_int32, c_uint64, c_void_p
from functools import cache
from pathlib import Path
from typing import ClassVar, Final

import mujoco

from controller.errors import InputError
from controller.library import REMEDY, SvGoal, library
from sim_models.statistics import STATISTICS

PATH: Final = Path(__file__).resolve().parent / "librollouts.so"

JOINT_MAX: Final = 32
FOOT_MAX: Final = 8
HEAD_MAX: Final = 8
SENSOR_MAX: Final = 32
GOAL_RING: Final = 64
SAMPLE_RING: Final = 512
TRACE_POSE: Final = ("x", "y", "z", "heading", "roll", "pitch", "clearance", "force", "px")
SENSORS: Final = ("x", "y", "z", "heading", "roll", "pitch", "force", "vx", "vy", "vz")


class SvRolloutSetup(ctypes.Structure):
    """Mirror `sv_rollout_setup` of `native/rollout.h`."""

    _fields_: ClassVar = [
        *((name, c_int32) for name in ("nstep", "nsub", "form", "base", "njoint", "nfoot", "nhead", "nsensor")),
        *((name, c_int32) for name in ("window", "stop_head", "stop_flight_substeps", "stop_early", "timer")),
        *((name, c_double) for name in ("stop_tilt_cos", "base_z", "foot_radius")),
        ("foot", c_double * (3 * FOOT_MAX)),
        ("neutral", c_double * JOINT_MAX),
        ("rest", c_double * JOINT_MAX),
        ("torque_max", c_double * JOINT_MAX),
        ("load_speed", c_double * JOINT_MAX),
        ("head", c_int32 * HEAD_MAX),
        *((name, c_int32 * JOINT_MAX) for name in ("qpos", "dof", "actuator", "unlimited")),
        ("sensor", c_int32 * SENSOR_MAX),
        *((name, c_void_p) for name in ("qpos0", "encoder", "sample", "sampled")),
    ]


class SvRolloutCase(ctypes.Structure):
    """Mirror `sv_rollout_case` of `native/rollout.h`."""

    _fields_: ClassVar = [
        ("cycle", c_void_p),
        ("goal", SvGoal),
        ("seed", c_uint64),
        ("latency", c_int32),
        *((name, c_float) for name in ("pose_noise", "angle_noise", "force_noise")),
        ("encoder_bias", c_float * JOINT_MAX),
        ("initial", c_float * JOINT_MAX),
        ("input_scale", c_float * JOINT_MAX),
    ]


class SvResults(ctypes.Structure):
    """Mirror `sv_results` of `native/rollout.h`."""

    _fields_: ClassVar = [(name, c_void_p) for name in ("statistics", "traces", "raw", "outputs", "goal_counts")]


class BatchConfig(ctypes.Structure):
    """Mirror `mjBatchConfig` of `mujoco/mjbatch.h`."""

    _fields_: ClassVar = [("nthread", c_int), ("persistent", ctypes.c_ubyte)]


@cache
def mujoco_library() -> ctypes.CDLL:
    """Return the MuJoCo library that the `mujoco` package has loaded, its symbols open to ours.

    Raises:
        InputError: the package holds no such library
    """
    found = sorted(Path(mujoco.__file__).parent.glob("libmujoco.*"))
    if not found:
        raise InputError(f"{Path(mujoco.__file__).parent}: there is no libmujoco here; reinstall mujoco-core")
    lib = ctypes.CDLL(str(found[0]), mode=ctypes.RTLD_GLOBAL)
    lib.mj_version.restype = c_int
    lib.mjb_makeBatch.restype = c_void_p
    lib.mjb_makeBatch.argtypes = (c_void_p, c_int, POINTER(BatchConfig), c_char_p, c_int)
    lib.mjb_deleteBatch.restype = None
    lib.mjb_deleteBatch.argtypes = (c_void_p,)
    lib.mjb_expand.restype = c_void_p
    lib.mjb_expand.argtypes = (c_void_p, c_char_p, POINTER(c_int), POINTER(c_int))
    lib.mjb_setConst.argtypes = (c_void_p, c_void_p, c_int)
    lib.mjb_state.restype = c_void_p
    lib.mjb_state.argtypes = (c_void_p,)
    lib.mjb_rollout.argtypes = (c_void_p, c_void_p, c_int, c_int, c_void_p, c_int, c_void_p, c_int)
    lib.mjb_error.restype = c_char_p
    lib.mjb_error.argtypes = (c_void_p, c_int)
    return lib


@cache
def rollout_library() -> ctypes.CDLL:
    """Load the compiled rollouts, once, and check that they fit this Python code and the installed MuJoCo.

    Raises:
        InputError: they are not built, do not load, or belong to another MuJoCo
    """
    library()
    engine = mujoco_library()
    if not PATH.exists():
        raise InputError(f"{PATH}: the rollout library is not built; {REMEDY}")
    try:
        lib = ctypes.CDLL(str(PATH))
        lib.sv_rollout_mujoco_version.restype = c_int32
        lib.sv_rollout_sizes.argtypes = (POINTER(c_int32),)
        lib.sv_rollout_sizes.restype = None
        lib.sv_noise.restype = c_double
        lib.sv_noise.argtypes = (c_uint64, c_int32, c_int32)
        lib.sv_rollout_run.restype = c_int32
        lib.sv_rollout_run.argtypes = (
            c_void_p,
            c_void_p,
            c_int32,
            POINTER(SvRolloutSetup),
            c_void_p,
            POINTER(SvResults),
        )
    except (OSError, AttributeError) as error:
        raise InputError(f"{PATH}: the rollout library does not load ({error}); {REMEDY}") from None
    built, installed = lib.sv_rollout_mujoco_version(), engine.mj_version()
    if built != installed:
        raise InputError(f"{PATH}: built for MuJoCo {built}, but {installed} is installed; {REMEDY}")
    sizes = (c_int32 * 4)()
    lib.sv_rollout_sizes(sizes)
    mirrored = (*map(ctypes.sizeof, (SvRolloutSetup, SvRolloutCase)), STATISTICS.itemsize, ctypes.sizeof(SvResults))
    if tuple(sizes) != mirrored:
        raise InputError(f"{PATH}: the rollout library was built from another version of its header; {REMEDY}")
    return lib
