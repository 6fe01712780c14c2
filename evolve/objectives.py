"""Objectives beside fitness: what they measure, and how a population ranks by all of them at once."""

from __future__ import annotations

import functools
from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from controller import Program
from controller.operations import BY_OPCODE
from evolve.evaluate import Evaluation
from firmware_gen.transpiler.runtime_functions import operations_of, read_runtime_functions

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def points(
    names: Sequence[str], evaluation: Evaluation, phase: float, nodes: IntArray, programs: Sequence[Program]
) -> FloatArray:
    """Return where individuals stand: fitness, then what is asked for beside it; lower is better in each.

    Args:
        names: of the objectives beside fitness, some of `evolve.settings.OBJECTIVES`
        evaluation: how they did
        phase: weight of the style points
        nodes: size of each genotype, (n,)
        programs: their programs, (n,)

    Returns:
        the points, (n, 1 + len(names))
    """
    columns = [evaluation.fitness(phase)]
    for name in names:
        if name == "size":
            columns.append(nodes.astype(np.float64))
        elif name == "instructions":
            columns.append(np.array([worst_case(program) for program in programs], np.float64))
        else:
            columns.append(evaluation.peak_torque)
    return np.stack(columns, axis=1)


def worst_case(program: Program) -> int:
    """Return how many float operations and comparisons a step takes at most, as the report of the generated C does.

    Args:
        program: the program
    """
    bounds = _bounds()
    return sum(bounds[op] for op in program.instructions["op"].tolist())


def fronts(points: FloatArray) -> IntArray:
    """Sort points into fronts: nobody in front 0 is dominated, nobody in front 1 but by front 0, and so on.

    One point dominates another if it is nowhere worse and somewhere better.

    Args:
        points: finite, lower is better, (n, nobjective)

    Returns:
        the front of each, (n,)

    Source: Deb, Pratap, Agarwal & Meyarivan 2002, §III.A; the order of the work as Zhang et al. 2015 (ENS-BS).
    """
    found = np.empty(len(points), np.int64)
    members: list[list[int]] = []
    # sorted so, no point is dominated by a later one; one that a front does not dominate no later front dominates
    for index in np.lexsort(points.T[::-1]).tolist():

        def clear(front: int, point: FloatArray = points[index]) -> bool:
            others = points[members[front]]
            return not bool(np.any(np.all(others <= point, axis=1) & np.any(others < point, axis=1)))

        found[index] = bisect_left(range(len(members)), True, key=clear)
        if found[index] == len(members):
            members.append([])
        members[found[index]].append(index)
    return found


def crowding(points: FloatArray) -> FloatArray:
    """Return how far the neighbours of each point of one front are apart, summed over the objectives.

    Args:
        points: of one front, finite, (n, nobjective)

    Returns:
        distance of each, in parts of the front's extent; infinite at the ends of an objective, (n,)

    Source: Deb, Pratap, Agarwal & Meyarivan 2002, §III.B.
    """
    distance = np.zeros(len(points))
    for values in points.T:
        order = np.argsort(values, kind="stable")
        extent = values[order[-1]] - values[order[0]]
        distance[order[[0, -1]]] = np.inf
        if extent > 0:
            distance[order[1:-1]] += (values[order[2:]] - values[order[:-2]]) / extent
    return distance


def pareto_ranks(points: FloatArray, complete: npt.NDArray[np.bool_]) -> IntArray:
    """Rank a population by fronts, then by room around, then by the first objective.

    Whoever met all conditions comes before whoever did not, and who has no finite point last.

    Args:
        points: lower is better, (population, nobjective)
        complete: whether each point is over all of the generation's conditions, (population,)

    Returns:
        rank of each individual, 0 is the best, (population,)

    Source: Deb, Pratap, Agarwal & Meyarivan 2002 (NSGA-II).
    """
    finite = np.isfinite(points).all(axis=1)
    group = np.where(finite, np.where(complete, 0, 1), 2)
    front, room = np.zeros(len(points), np.int64), np.zeros(len(points))
    for members in (np.flatnonzero(group == number) for number in (0, 1)):
        front[members] = fronts(points[members])
        for number in np.unique(front[members]):
            equals = members[front[members] == number]
            room[equals] = crowding(points[equals])
    order = np.lexsort((points[:, 0], -room, front, group))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank


@functools.cache
def _bounds() -> dict[int, int]:
    """Return the worst case of each operation, by opcode."""
    functions = read_runtime_functions()
    return {opcode: operations_of(operation.c, functions) for opcode, operation in BY_OPCODE.items()}
