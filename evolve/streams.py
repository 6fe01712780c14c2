"""Streams of random numbers: one for each purpose and generation, so that no draw depends on another's length."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

RNG_NAME = "philox"


class Stream(IntEnum):
    """Name what random numbers are for; the values are part of a run's definition and never change."""

    START = 0
    VARIATION = 1
    CONDITIONS = 2
    DECISION = 3
    HELD_OUT = 4
    STATED = 5
    PARSIMONY = 6


def generator(seed: int, stream: Stream, generation: int = 0) -> np.random.Generator:
    """Return the generator of one purpose in one generation.

    Args:
        seed: seed of the run
        stream: what the numbers are for
        generation: when

    Returns:
        a counter-based generator, independent of all the others
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(int(stream), generation))
    return np.random.Generator(np.random.Philox(sequence))
