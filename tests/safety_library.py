"""The firmware's judges as a shared library with the data of a shipped rig, for tests."""

import ctypes
import subprocess
from ctypes import byref, c_int32, c_uint8, c_uint32
from pathlib import Path

from firmware_gen.projects.rig_config import rig_header, rig_source
from firmware_gen.transpiler.unit import make_unit

ROOT = Path(__file__).parents[1]
FLAGS = "-std=c99 -O1 -g -ffp-contract=off -Wall -Wextra -Wconversion -Wdouble-promotion -Wmissing-prototypes -Werror"
TRAPS = "-fsanitize=undefined -fsanitize-undefined-trap-on-error -ftrapv"
JOINT_MAX = SENSOR_MAX = 16
STATUSES = ("data", "refused", "missing", "corrupt")


class SvReply(ctypes.Structure):
    _fields_ = (
        *((name, c_uint8) for name in ("status", "error", "late")),
        ("t_us", c_uint32),
    )


class _Joint(ctypes.Structure):
    _fields_ = (
        *((name, c_int32) for name in ("missed", "poor", "alerted", "jumped", "hot", "low")),
        ("seen", c_uint8),
        ("off_track", c_uint8),
        ("believed", c_int32),
        ("believed_us", c_uint32),
        ("off_track_us", c_uint32),
    )


class _Watch(ctypes.Structure):
    _fields_ = (
        ("joints", _Joint * JOINT_MAX),
        ("stale", c_int32 * SENSOR_MAX),
        *((name, c_int32) for name in ("tilted", "overruns", "reason", "joint", "a", "b")),
    )


class Judges:
    """The judges of one rig, and what they have counted.

    Args:
        folder: where the library is built
        rig: the rig
        controller: any that fits it
    """

    def __init__(self, folder, rig, controller):
        self._lib = ctypes.CDLL(str(_build(folder, rig, controller)))
        self._rig = byref(c_int32.in_dll(self._lib, "servolve_rig"))
        self._watch = _Watch()
        for name in ("sv_judge_sensors", "sv_judge_encoders", "sv_judge_tracking", "sv_judge_speeds"):
            getattr(self._lib, name).restype = c_int32
        self.start()

    def start(self):
        """Forget everything."""
        self._lib.sv_watch_init(byref(self._watch))

    def judge(self, name, *arguments):
        """Return (reason, joint, a, b), or None; lists are arrays of counts."""
        given = [(c_int32 * len(value))(*value) if isinstance(value, list) else value for value in arguments]
        ended = getattr(self._lib, f"sv_judge_{name}")(self._rig, byref(self._watch), *given)
        watch = self._watch
        return (watch.reason, watch.joint, watch.a, watch.b) if ended else None

    def judge_torque(self, joint, torque):
        """Likewise; this one needs no rig."""
        ended = self._lib.sv_judge_torque(byref(self._watch), joint, torque)
        return (self._watch.reason, self._watch.joint) if ended else None

    def alert(self, joint, reply):
        """Return whether to look into what a servo reports."""
        return bool(self._lib.sv_judge_alert(self._rig, byref(self._watch), joint, byref(reply)))


def replies(values):
    """Return host replies as an array of the firmware's."""
    return (SvReply * len(values))(*map(reply_of, values))


def reply_of(reply):
    return SvReply(STATUSES.index(reply.status), reply.error, reply.late, 0)


def _build(folder, rig, controller):
    (folder / "rig.c").write_text(rig_source(rig, controller))
    (folder / "rig.h").write_text(rig_header(rig, make_unit(controller)))
    runtime, shared = ROOT / "firmware_gen" / "runtime", ROOT / "controller" / "runtime"
    sources = [folder / "rig.c", runtime / "sv_safety.c", shared / "sv_cycle.c", shared / "sv_program.c"]
    path = folder / "safety.so"
    command = ["gcc", *FLAGS.split(), *TRAPS.split(), "-shared", "-fPIC", f"-I{runtime}", f"-I{shared}", f"-I{folder}"]
    subprocess.run([*command, *map(str, sources), "-o", str(path)], check=True)
    return path
