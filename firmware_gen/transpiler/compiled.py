"""Generated C, compiled by the system's compiler and called from Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Final

import numpy as np
import numpy.typing as npt

from controller import Controller
from controller.errors import InputError, RunError
from controller.reference import check_inputs
from firmware_gen.transpiler.generate import Transpiled, transpile

BASE_FLAGS: Final = ("-std=c99", "-shared", "-fPIC")

COMPILE_SECONDS_MAX: Final = 600.0

_PACKAGES: Final = MappingProxyType({"cc": "gcc", "arm-none-eabi-gcc": "gcc-arm-none-eabi"})


class CompiledController:
    """Hold a controller that runs as compiled C; close it, or use it in a ``with`` statement.

    Args:
        controller: what was compiled
        name: what its symbols begin with
        library: the loaded shared library
        folder: the folder to remove at the end, or None where someone else does
    """

    def __init__(
        self,
        controller: Controller,
        name: str,
        library: ctypes.CDLL,
        folder: tempfile.TemporaryDirectory[str] | None = None,
    ) -> None:
        self._controller = controller
        self._folder = folder
        self._run = library[f"{name}_run"]
        self._run.argtypes = (ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)
        self._run.restype = None
        self._clamp = library[f"{name}_clamp"]
        self._clamp.argtypes = (ctypes.c_void_p,)
        self._clamp.restype = None
        self._run_commands = library[f"{name}_run_commands"]
        self._run_commands.argtypes = (ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)
        self._run_commands.restype = None
        self._selftest = library[f"{name}_selftest"]
        self._selftest.argtypes = ()
        self._selftest.restype = ctypes.c_int32

    def __enter__(self) -> CompiledController:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Remove the folder that it was built in."""
        if self._folder is not None:
            self._folder.cleanup()

    def run(self, inputs: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Evaluate successive steps from the start.

        Args:
            inputs: terminals, float32, (nstep, ninput)

        Returns:
            the program's outputs, unclamped, float32, (nstep, noutput)

        Raises:
            InputError: the inputs have the wrong shape
        """
        rows = check_inputs(self._controller.program, inputs)
        outputs = np.empty((len(rows), len(self._controller.outputs)), np.float32)
        self._run(len(rows), rows.ctypes.data, outputs.ctypes.data)
        return outputs

    def clamp(self, outputs: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Make a program's outputs fit to be commanded: neutral for a NaN, the rest within its limits.

        Args:
            outputs: float32, (nstep, noutput)

        Returns:
            the same, clamped, (nstep, noutput)
        """
        clamped = np.array(outputs, np.float32, order="C")
        for row in clamped:
            self._clamp(row.ctypes.data)
        return clamped

    def command(self, outputs: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Turn successive outputs of a program into commands, from the start.

        Args:
            outputs: float32, unclamped, (nstep, noutput)

        Returns:
            commands, float32, (nstep, noutput) [rad, rad/s]
        """
        rows = np.ascontiguousarray(outputs, np.float32)
        commands = np.empty_like(rows)
        self._run_commands(len(rows), rows.ctypes.data, commands.ctypes.data)
        return commands

    def selftest(self) -> int:
        """Run the generated selftest; return 0 where all is well."""
        return int(self._selftest())


def compile_controller(
    controller: Controller, *, compiler: str = "cc", flags: Sequence[str] = ("-O2",)
) -> CompiledController:
    """Transpile a controller, compile it into a temporary folder and load it.

    Args:
        controller: a verified controller
        compiler: the compiler's command
        flags: added to `BASE_FLAGS`

    Returns:
        the running thing, to be closed

    Raises:
        InputError: there is no such compiler
        RunError: it does not compile
    """
    folder = tempfile.TemporaryDirectory(prefix="servolve-c-")
    try:
        library, names = _build(Path(folder.name), [controller], compiler, flags)
    except BaseException:
        folder.cleanup()
        raise
    return CompiledController(controller, names[0], library, folder)


@contextmanager
def compile_controllers(
    controllers: Sequence[Controller], *, compiler: str = "cc", flags: Sequence[str] = ("-O2",)
) -> Iterator[list[CompiledController]]:
    """Compile many controllers at once, for as long as the ``with`` statement lasts.

    Args:
        controllers: verified controllers, (n,)
        compiler: the compiler's command
        flags: added to `BASE_FLAGS`

    Returns:
        the running things, (n,)

    Raises:
        InputError: there is no such compiler
        RunError: it does not compile
    """
    with tempfile.TemporaryDirectory(prefix="servolve-c-") as folder:
        library, names = _build(Path(folder), controllers, compiler, flags)
        yield [
            CompiledController(controller, name, library) for controller, name in zip(controllers, names, strict=True)
        ]


def run_compiler(command: Sequence[str], folder: Path) -> None:
    """Run a compiler.

    Args:
        command: its command and arguments
        folder: where it works

    Raises:
        InputError: there is no such compiler
        RunError: it reports an error, or takes too long
    """
    if shutil.which(command[0]) is None:
        package = _PACKAGES.get(command[0], command[0])
        raise InputError(f"there is no compiler '{command[0]}'; install one, as with: apt-get install {package}")
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=COMPILE_SECONDS_MAX,
        )
    except subprocess.TimeoutExpired:
        raise RunError(
            f"{' '.join(command[:4])} … took more than {COMPILE_SECONDS_MAX:g} s; simplify the controller"
        ) from None
    if done.returncode != 0:
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip()[:200])
        raise RunError(f"{' '.join(command[:4])} … failed: {first}")


def _build(
    folder: Path, controllers: Sequence[Controller], compiler: str, flags: Sequence[str]
) -> tuple[ctypes.CDLL, list[str]]:
    names = [f"c{i}" for i in range(len(controllers))]
    files = [transpile(controller, folder, name) for controller, name in zip(controllers, names, strict=True)]
    runner = folder / "runner.c"
    runner.write_text("#include <stdint.h>\n" + "".join(_runner(file) for file in files), encoding="utf-8")
    sources = [file.source.name for file in files]
    run_compiler([compiler, *BASE_FLAGS, *flags, "-o", "controllers.so", *sources, runner.name], folder)
    return ctypes.CDLL(str(folder / "controllers.so")), names


def _runner(file: Transpiled) -> str:
    """Return C that steps a controller through an array."""
    name = file.unit.name
    return f"""
#include "{name}.h"

void {name}_run(int32_t nstep, const float* inputs, float* outputs);

void {name}_run(int32_t nstep, const float* inputs, float* outputs) {{
  {name}_state state;
  {name}_init(&state);
  for (int32_t i = 0; i < nstep; i++) {{
    {name}_step(&state, inputs + (int64_t)i * {name}_ninput, outputs + (int64_t)i * {name}_noutput);
  }}
}}

void {name}_run_commands(int32_t nstep, const float* outputs, float* commands);

void {name}_run_commands(int32_t nstep, const float* outputs, float* commands) {{
  {name}_state state;
  {name}_init(&state);
  for (int32_t i = 0; i < nstep; i++) {{
    {name}_command(&state, outputs + (int64_t)i * {name}_noutput, commands + (int64_t)i * {name}_noutput);
  }}
}}
"""
