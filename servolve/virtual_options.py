"""What a virtual rig is asked to be: another body than the simulation's, faults, a seed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from controller import Rig
from controller.errors import InputError

if TYPE_CHECKING:
    from deploy.virtual.rig import VirtualRig
    from deploy.virtual.twin import Twin

# only a virtual rig needs MuJoCo, so what does is imported where it is needed


@dataclass(frozen=True)
class VirtualOptions:
    """Say what a virtual rig is to be.

    Args:
        twin: how its physics differ from the simulation's, or None
        faults: what goes wrong
        seed: of faults and noise
    """

    twin: Twin | None
    faults: tuple[str, ...]
    seed: int

    def check(self, rig: Rig) -> None:
        """Refuse faults that are none, or that a rig can not have.

        Args:
            rig: which rig

        Raises:
            InputError: a fault is no fault, or of something that the rig does not have
        """
        if self.faults:
            from deploy.virtual.faults import check_faults, parse_fault

            check_faults([parse_fault(text) for text in self.faults], rig)

    def rig(self, rig: Rig) -> VirtualRig:
        """Return the virtual rig.

        Args:
            rig: which rig

        Raises:
            InputError: as `check`, or the twin asks for what can not be
        """
        from deploy.virtual.faults import parse_fault
        from deploy.virtual.rig import VirtualRig

        return VirtualRig(rig, seed=self.seed, twin=self.twin, faults=[parse_fault(text) for text in self.faults])


def virtual_options(twin: Path | None, fault: tuple[str, ...], seed: int) -> VirtualOptions:
    """Read what the command line says of a virtual rig.

    Args:
        twin: twin file, or None
        fault: faults, and files of faults
        seed: of faults and noise

    Raises:
        InputError: a file can not be read, or the seed is negative
    """
    if seed < 0:
        raise InputError(f"--seed {seed}: is negative; give a whole number from 0")
    loaded = None
    if twin is not None:
        from deploy.virtual.twin import load_twin

        loaded = load_twin(twin)
    specs: tuple[str, ...] = ()
    if fault:
        from deploy.virtual.faults import fault_specs

        specs = fault_specs(fault)
    return VirtualOptions(loaded, specs, seed)
