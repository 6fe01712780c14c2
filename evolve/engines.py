"""Engines by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

from controller.errors import InputError
from evolve.engine import Engine
from evolve.gep.engine import gep
from evolve.gp.tree_gp import tree_gp
from evolve.settings import Settings

ENGINES: Final[Mapping[str, Callable[[Sequence[str], int, Settings], Engine]]] = MappingProxyType(
    {"gp": tree_gp, "gep": gep}
)
"""What makes each engine from the terminals, the number of outputs and the run's numbers."""


def make_engine(name: str, terminals: Sequence[str], noutput: int, settings: Settings) -> Engine:
    """Return an engine.

    Args:
        name: of the engine
        terminals: names of the inputs
        noutput: outputs of a controller
        settings: the run's numbers

    Returns:
        the engine

    Raises:
        InputError: there is no such engine
    """
    if name not in ENGINES:
        raise InputError(f"engine {name}: there is no such engine; choose one of {', '.join(ENGINES)}")
    return ENGINES[name](terminals, noutput, settings)
