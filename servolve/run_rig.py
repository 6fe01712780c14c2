"""The rig of a controller: the one that was asked for, or the one that it was evolved on."""

from __future__ import annotations

from pathlib import Path

from controller import Controller, Rig, load_rig
from controller.controller_file import RUN
from controller.errors import InputError
from controller.rig_file import rig_names


def rig_of(path: Path, controller: Controller, asked: str | None, otherwise: str | None = None) -> Rig:
    """Load the rig that a controller is to run on; of a run, the folder keeps the one that it was evolved on.

    Args:
        path: the controller's file, or its run folder
        controller: the controller
        asked: name or path of the rig; None: the one that the controller was evolved on
        otherwise: name of the rig of a controller that does not say on which it was evolved; None: it must

    Returns:
        the rig

    Raises:
        InputError: there is no such rig, it has changed since the run began, or it is not known which
    """
    if asked is not None:
        return load_rig(asked)
    if path.is_dir() and (path / RUN).is_file():
        # what a run keeps is read by what wrote it, which needs the simulation's packages
        from evolve.runs.run_file import load_rig_again, read_run_file

        return load_rig_again(path, read_run_file(path))
    name = controller.provenance.get("rig", otherwise)
    if name is None:
        raise InputError(f"{path}: does not say on which rig it was evolved; give --rig a name or the path of a file")
    if name not in rig_names():
        raise InputError(
            f"{path}: was evolved on rig '{name}', which does not come with servolve; give --rig the path of its file"
        )
    return load_rig(name)
