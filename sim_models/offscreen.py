"""Pictures of a model without a screen."""

from __future__ import annotations

import importlib
import os
from types import TracebackType
from typing import Any, Final, Self

import mujoco
import numpy as np
import numpy.typing as npt

from controller.errors import RunError

_BACKENDS: Final = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa", "glfw": "mujoco.glfw"}
_REMEDY: Final = "install libegl1 and libgl1-mesa-dri, or set MUJOCO_GL to egl, osmesa or glfw, whichever works here"


class Offscreen:
    """Own an OpenGL context that draws a model; close it, or use it in a ``with`` statement.

    The environment variable MUJOCO_GL chooses the back end; without it, EGL, which needs no display.

    Args:
        model: the model to draw
        width: of the pictures [pixels]
        height: of the pictures [pixels]

    Raises:
        RunError: there is no OpenGL here
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._gl: Any = None
        self._context: Any = None
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        name = os.environ.get("MUJOCO_GL", "").strip().lower() or "egl"
        try:
            if name not in _BACKENDS:
                raise RuntimeError(f"MUJOCO_GL is {name!r}")
            # a missing driver shows as any of these, at import or at the first call
            self._gl = importlib.import_module(_BACKENDS[name]).GLContext(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        except (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError) as error:
            self.close()
            reason = " ".join(str(error).split()) or type(error).__name__
            raise RunError(f"pictures: there is no OpenGL for {name} here ({reason}); {_REMEDY}") from None
        self._model = model
        self._scene = mujoco.MjvScene(model, maxgeom=2000)
        self._option = mujoco.MjvOption()
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._shape = (height, width, 3)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the context."""
        if self._context is not None:
            self._context.free()
            self._context = None
        if self._gl is not None:
            self._gl.free()
            self._gl = None

    def picture(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> npt.NDArray[np.uint8]:
        """Draw a state.

        Args:
            data: the state, after `mj_forward`
            camera: where to look from

        Returns:
            Red, green, blue, first row on top, uint8, (height, width, 3).
        """
        self._gl.make_current()
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, camera, every, self._scene)
        image = np.empty(self._shape, np.uint8)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(image, None, self._rect, self._context)
        return np.ascontiguousarray(image[::-1])
