"""Tree genetic programming for the robust lamp with DEAP, as an experienced user writes it: what `bench evolve` races.

The same as servolve's search: function set, terminals, constants, ramped start, tournaments, share and kind of
crossover, bounds, conditions of each generation, control cycle, body and fitness. Primitives print as Python operators,
so that a compiled tree is plain bytecode; each tree is compiled once a generation, in the process that runs it.
"""

from __future__ import annotations

import dataclasses
import functools
import multiprocessing
import operator
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
from deap import base, gp, tools

from controller import Controller, load_rig
from controller.lowering import lower
from controller.source import Apply, Constant, Expression, Name, Source
from evolve.conditions import Conditions, draw_conditions
from evolve.search import phase_of
from evolve.settings import Settings
from evolve.streams import Stream, generator
from evolve.task import Task, score
from evolve.template import controller_template
from servolve.deap_rollout import TERMINALS, Case, Program, make_cases, make_loop, rollout
from sim_models.rollouts import Rollouts

_LEAF_SHARE: Final = 0.1  # of crossover points (Koza 1992, §6.4.1)
_CHUNK: Final = 2  # controllers that a process takes at a time


@dataclass(frozen=True)
class Baseline:
    """Say what to run.

    Args:
        task: a task over the terminals that `servolve.deap_rollout` knows
        rig: name or path of the rig
        settings: the run's numbers; racing and caching are left out
        timestep_s: MuJoCo's step [s]
        stop_early: whether physics ends when a rollout is over
    """

    task: Task
    rig: str
    settings: Settings
    timestep_s: float
    stop_early: bool


class Fitness(base.Fitness):  # type: ignore[misc]
    """Minimise one number."""

    weights = (-1.0,)


class Individual(list[Any]):
    """Hold the trees of a controller, one for each output, and their fitness."""

    def __init__(self, trees: Sequence[Any] = ()) -> None:
        super().__init__(trees)
        self.fitness = Fitness()


class DeapSearch:
    """Evolve with DEAP on a pool of processes; close it, or use it in a ``with`` statement.

    Args:
        baseline: what to run
        seed: of all chance
        processes: how many simulate
    """

    def __init__(self, baseline: Baseline, seed: int, processes: int) -> None:
        self.template = controller_template(baseline.task, load_rig(baseline.rig), baseline.settings)
        self._baseline = baseline
        self._seed = seed
        self._pset = primitive_set(baseline.settings)
        context = multiprocessing.get_context("spawn")
        self._pool = context.Pool(processes, _open_worker, (baseline, seed))
        # none is late because it still starts
        self._pool.map(_is_ready, range(4 * processes), chunksize=1)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the processes."""
        self._pool.terminate()
        self._pool.join()

    def generations(self) -> Iterator[Controller]:
        """Evolve, and yield the best controller of each generation."""
        settings, toolbox = self._baseline.settings, _toolbox(self._baseline.settings, self._pset)
        random.seed(self._seed)
        population = [toolbox.individual() for _ in range(settings.population)]
        for number in range(settings.generations):
            if number:
                population = _offspring(toolbox, settings, population)
            for individual, fitness in zip(population, self.evaluate(number, population), strict=True):
                individual.fitness.values = (fitness,)
            yield self.controller(tools.selBest(population, 1)[0])

    def evaluate(self, number: int, population: Sequence[Sequence[Any]]) -> list[float]:
        """Let a population meet the conditions of a generation.

        Args:
            number: of the generation
            population: trees of each, (population,)

        Returns:
            fitness of each, (population,)
        """
        jobs = [(number, [str(tree) for tree in trees]) for trees in population]
        return self._pool.map(_evaluate, jobs, chunksize=_CHUNK)

    def controller(self, trees: Sequence[Any]) -> Controller:
        """Return the controller that trees are."""
        source = Source(tuple(to_expression(tree) for tree in trees))
        return dataclasses.replace(self.template, source=source, program=lower(source, TERMINALS))

    def trees(self, source: Source) -> list[Any]:
        """Return a controller's source as trees, one for each output."""
        return [from_expression(self._pset, expression) for expression in source.outputs]


def primitive_set(settings: Settings) -> gp.PrimitiveSet:
    """Return the papers' function set, the lamp's terminals and constants.

    Args:
        settings: the run's numbers

    Returns:
        A `gp.PrimitiveSet` whose primitives print as Python operators.
    """
    pset = gp.PrimitiveSet("lamp", len(TERMINALS))
    pset.renameArguments(**{f"ARG{i}": name for i, name in enumerate(TERMINALS)})
    for symbol, name, function in (("+", "add", operator.add), ("-", "sub", operator.sub), ("*", "mul", operator.mul)):
        pset.addPrimitive(function, 2, name=name)
        pset.mapping[name].seq = f"({{0}} {symbol} {{1}})"
    pset.addPrimitive(divide, 2)
    pset.addPrimitive(choose, 3)
    pset.mapping["choose"].seq = "({1} if {0} < 0.0 else {2})"
    pset.addEphemeralConstant("constant", functools.partial(_constant, settings.constant_max))
    return pset


def divide(a: float, b: float) -> float:
    """Return a / b, or 1 where b is 0."""
    return a / b if b else 1.0


def choose(a: float, b: float, c: float) -> float:
    """Return b where a is negative, else c."""
    return b if a < 0.0 else c


def _constant(constant_max: float) -> float:
    return round(random.uniform(-constant_max, constant_max), 4)


def to_expression(tree: Sequence[Any]) -> Expression:
    """Convert a tree to a controller's expression.

    Args:
        tree: nodes in prefix order

    Returns:
        The expression, constants rounded to binary32.
    """
    stack: list[Expression] = []
    for node in reversed(tree):
        if node.arity:
            stack.append(Apply(_OPERATIONS[node.name], tuple(stack.pop() for _ in range(node.arity))))
        else:
            stack.append(Name(node.value) if isinstance(node.value, str) else Constant(np.float32(node.value)))
    return stack.pop()


def from_expression(pset: gp.PrimitiveSet, root: Expression) -> gp.PrimitiveTree:
    """Convert a controller's expression to a tree.

    Args:
        pset: from `primitive_set`
        root: an expression over the same functions and terminals

    Returns:
        A `gp.PrimitiveTree`.
    """
    nodes: list[Any] = []
    pending = [root]
    while pending:
        match pending.pop():
            case Apply(operation=operation, operands=operands):
                nodes.append(pset.mapping[_PRIMITIVES[operation]])
                pending.extend(reversed(operands))
            case Name(name=name):
                nodes.append(pset.mapping[name])
            case Constant(value=value):
                nodes.append(gp.Terminal(float(value), False, gp.__type__))
    return gp.PrimitiveTree(nodes)


def _toolbox(settings: Settings, pset: gp.PrimitiveSet) -> base.Toolbox:
    """Register the operators, as DEAP's manual does."""
    toolbox = base.Toolbox()
    depths = {"min_": settings.grow_depth_low, "max_": settings.grow_depth_high}
    toolbox.register("tree", tools.initIterate, gp.PrimitiveTree, functools.partial(gp.genHalfAndHalf, pset, **depths))
    toolbox.register("individual", tools.initRepeat, Individual, toolbox.tree, n=3)
    toolbox.register("select", tools.selTournament, tournsize=settings.tournament)
    toolbox.register("cross", gp.cxOnePointLeafBiased, termpb=_LEAF_SHARE)
    toolbox.decorate("cross", gp.staticLimit(operator.attrgetter("height"), settings.depth_max))
    toolbox.decorate("cross", gp.staticLimit(len, settings.nodes_max))
    return toolbox


def _offspring(toolbox: base.Toolbox, settings: Settings, population: Sequence[Individual]) -> list[Individual]:
    """Return the next population: by crossover of one output's trees, or as the parent was."""
    children: list[Individual] = []
    while len(children) < len(population):
        if random.random() < settings.crossover:
            first, second = (Individual(parent) for parent in toolbox.select(population, 2))
            place = random.randrange(len(first))
            # trees are shared until they change
            copies = gp.PrimitiveTree(first[place]), gp.PrimitiveTree(second[place])
            first[place], second[place] = toolbox.cross(*copies)
            children += [first, second]
        else:
            children.append(Individual(toolbox.select(population, 1)[0]))
    return children[: len(population)]


class _Worker:
    """Run the rollouts of one process.

    Args:
        baseline: what to run
        seed: of the conditions
    """

    def __init__(self, baseline: Baseline, seed: int) -> None:
        self._baseline, self._seed = baseline, seed
        rig = load_rig(baseline.rig)
        template = controller_template(baseline.task, rig, baseline.settings)
        limit_s, stop = baseline.settings.time_limit_s, baseline.task.stop
        self._pset = primitive_set(baseline.settings)
        self._loop = make_loop(rig, template, baseline.timestep_s, limit_s, stop, stop_early=baseline.stop_early)
        self._generation: tuple[int, Conditions, list[Case]] | None = None

    def evaluate(self, number: int, expressions: Sequence[str]) -> float:
        """Return the fitness of a controller under the conditions of a generation."""
        if self._generation is None or self._generation[0] != number:
            conditions = generation_conditions(self._baseline.settings, self._seed, number, len(expressions))
            self._generation = number, conditions, make_cases(self._loop, conditions)
        _, conditions, cases = self._generation
        programs: list[Program] = [gp.compile(expression, self._pset) for expression in expressions]
        statistics = np.array([rollout(self._loop, case, programs) for case in cases])
        ended = Rollouts(statistics, (), None, None, None, None, self._loop.nstep, self._loop.rig.period_s)
        main, style = score(self._baseline.task, ended, conditions.goal_m)
        fitness = float(np.mean(main + phase_of(number, self._baseline.settings.generations) * style))
        return fitness if fitness == fitness else float("inf")


def generation_conditions(settings: Settings, seed: int, number: int, njoint: int) -> Conditions:
    """Return the conditions that servolve's search draws for a generation.

    Args:
        settings: the run's numbers
        seed: of the run
        number: of the generation
        njoint: joints of the rig

    Returns:
        the conditions
    """
    rng = generator(seed, Stream.CONDITIONS, number if settings.redraw else 0)
    return draw_conditions(rng, settings, settings.goals, njoint, nominal=settings.nominal_goals)


_WORKERS: list[_Worker] = []  # of this process: what its pool's tasks find there


def _open_worker(baseline: Baseline, seed: int) -> None:
    _WORKERS[:] = [_Worker(baseline, seed)]


def _is_ready(_: int) -> bool:
    return bool(_WORKERS)


def _evaluate(job: tuple[int, Sequence[str]]) -> float:
    return _WORKERS[0].evaluate(*job)


_OPERATIONS: Final = {"add": "+", "sub": "-", "mul": "*", "divide": "%", "choose": "ifltz"}
_PRIMITIVES: Final = {operation: name for name, operation in _OPERATIONS.items()}
