"""The README of a firmware project."""

from __future__ import annotations

from controller import Controller
from controller.rig import Rig
from firmware_gen.board import Board


def readme_text(controller: Controller, rig: Rig, board: Board) -> str:
    """Write `README.md`.

    Args:
        controller: the controller
        rig: the rig
        board: the board
    """
    return f"# {controller.name} on {rig.name}, for {board.title}\n"
