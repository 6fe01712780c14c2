"""One perturbed MuJoCo model a simulation: a batch whose model fields differ from simulation to simulation."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np
import numpy.typing as npt

from controller.errors import RunError
from controller.rig import Rig
from sim_models.body import body_layout
from sim_models.native_rollouts import BatchConfig, mujoco_library
from sim_models.perturbations import Perturbations
from sim_models.servo import joint_parameters, write_servo


class SimulatedModels:
    """Own a MuJoCo batch; close it.

    Args:
        model: the nominal model, copied
        rig: the rig it was built for
        capacity: simulations that it can hold
        threads: threads that simulate

    Raises:
        RunError: MuJoCo cannot make the batch
    """

    def __init__(self, model: mujoco.MjModel, rig: Rig, capacity: int, threads: int) -> None:
        self.capacity = capacity
        self._model = model
        self._rig = rig
        self._lib = mujoco_library()
        message = ctypes.create_string_buffer(1000)
        config = BatchConfig(nthread=threads, persistent=0)
        self.address = self._lib.mjb_makeBatch(model._address, capacity, ctypes.byref(config), message, len(message))
        if not self.address:
            raise RunError(f"{rig.name}: MuJoCo cannot batch this body: {message.value.decode()}")
        self._expanded: dict[str, npt.NDArray[np.float64]] = {}

    def close(self) -> None:
        """Free the batch and its threads."""
        if self.address:
            self._lib.mjb_deleteBatch(self.address)
            self.address = None

    def error(self, sim: int) -> str:
        """Return MuJoCo's message on a failed simulation.

        Args:
            sim: which simulation
        """
        return str(self._lib.mjb_error(self.address, sim).decode())

    def perturb(self, perturbations: Perturbations, rows: npt.NDArray[np.int32]) -> None:
        """Give simulation i the rig of row ``rows[i]``.

        Args:
            perturbations: the rigs
            rows: one for each simulation, (n,), n at most the capacity
        """
        model, n = self._model, len(rows)
        scales = (perturbations.friction, perturbations.mass, perturbations.torque, perturbations.voltage)
        if not self._expanded and all(np.all(scale == 1.0) for scale in scales):
            return
        friction = self._field("geom_friction")
        friction[:n] = model.geom_friction
        friction[:n, :, 0] *= perturbations.friction[rows, None]
        gain, force = self._servo_rows(perturbations)
        self._field("actuator_gainprm")[:n] = gain[rows]
        self._field("actuator_forcerange")[:n] = force[rows]
        if any(joint.ideal for joint in self._rig.joints):
            self._field("actuator_biasprm")[:n] = self._ideal_bias(perturbations)[rows]
        if "body_mass" in self._expanded or np.any(perturbations.mass != 1.0):
            self._field("body_mass")[:n] = model.body_mass * perturbations.mass[rows, None]
            self._field("body_inertia")[:n] = model.body_inertia * perturbations.mass[rows, None, None]
            ids = np.arange(n, dtype=np.int32)
            if self._lib.mjb_setConst(self.address, ids.ctypes.data, n):
                raise RunError(f"{self._rig.name}: MuJoCo cannot compute the constants of a perturbed body")

    def _servo_rows(self, perturbations: Perturbations) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the motors' parameters of every perturbed rig: (nrow, nu, 10) and (nrow, nu, 2)."""
        gain = np.repeat(self._model.actuator_gainprm[None], len(perturbations), 0)
        force = np.repeat(self._model.actuator_forcerange[None], len(perturbations), 0)
        actuators = body_layout(self._model, self._rig).actuator
        for row in range(len(perturbations)):
            voltage = self._rig.supply_v * perturbations.voltage[row]
            for joint, actuator, torque in zip(self._rig.joints, actuators, perturbations.torque[row], strict=True):
                if perturbations.voltage[row] == 1.0 and torque == 1.0:
                    continue  # the model's own motor, which a twin may have changed
                if joint.ideal:
                    gain[row, actuator] *= torque * perturbations.voltage[row]
                    force[row, actuator] *= torque * perturbations.voltage[row]
                else:
                    parameters = joint_parameters(joint, voltage, float(torque))
                    write_servo(gain[row, actuator], force[row, actuator], parameters)
        return gain, force

    def _ideal_bias(self, perturbations: Perturbations) -> npt.NDArray[np.float64]:
        """Return spring and damper of every perturbed rig's ideal motors, as weak as their gain: (nrow, nu, 10)."""
        bias = np.repeat(self._model.actuator_biasprm[None], len(perturbations), 0)
        actuators = body_layout(self._model, self._rig).actuator
        for place, (joint, actuator) in enumerate(zip(self._rig.joints, actuators, strict=True)):
            if joint.ideal:
                scale = perturbations.torque[:, place] * perturbations.voltage
                bias[:, actuator] *= scale[:, None]
        return bias

    def _field(self, name: str) -> npt.NDArray[np.float64]:
        """Return a model field's values of every simulation, (capacity, …)."""
        if name not in self._expanded:
            size = ctypes.c_int()
            address = self._lib.mjb_expand(self.address, name.encode(), ctypes.byref(size), None)
            shape = (self.capacity, *np.shape(getattr(self._model, name)))
            buffer = (ctypes.c_double * (self.capacity * size.value)).from_address(address)
            self._expanded[name] = np.ctypeslib.as_array(buffer).reshape(shape)
        return self._expanded[name]
