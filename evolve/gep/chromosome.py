"""Chromosomes of gene expression programming: strings of fixed length, a gene for each output, read as expressions.

A gene is a head, where any symbol may stand, and a tail of terminals and constants only. The tail is so long that
every gene holds one whole expression, read breadth first from its first symbol; what follows is not expressed, but
may be again after a change further up.

Source: Ferreira 2001, §3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from controller.decimals import format_decimal, parse_decimal
from controller.errors import InputError
from controller.source import Apply, Constant, Expression, Source
from evolve.gp.tree import Primitives

_BAR = "|"  # between head and tail in a chromosome's text


@dataclass(frozen=True)
class Layout:
    """Hold what all chromosomes of a run have in common.

    Args:
        primitives: the symbols; a symbol's code is its index in functions, then terminals, then the constant
        head: symbols of a gene's head
        ngene: genes of a chromosome, one for each output
        function_share: share of functions among the symbols drawn for heads
    """

    primitives: Primitives
    head: int
    ngene: int
    function_share: float

    @cached_property
    def tail(self) -> int:
        """Return the symbols of a tail, h (n - 1) + 1 for functions of up to n operands (Ferreira 2001, eq. 3.4)."""
        return self.head * (max(self.primitives.arities) - 1) + 1

    @cached_property
    def arities(self) -> npt.NDArray[np.int64]:
        """Return the number of operands of each code, int64, (ncode,)."""
        return np.array(self.primitives.arities, np.int64)

    @cached_property
    def in_head(self) -> npt.NDArray[np.bool_]:
        """Return where functions may stand, (ngene, head + tail)."""
        where = np.zeros((self.ngene, self.head + self.tail), np.bool_)
        where[:, : self.head] = True
        return where


@dataclass(frozen=True, eq=False)
class Chromosome:
    """Hold one chromosome.

    Args:
        codes: code of each symbol, int16, (ngene, head + tail)
        values: value of each constant, 0 at every other symbol, float32, (ngene, head + tail)
    """

    codes: npt.NDArray[np.int16]
    values: npt.NDArray[np.float32]


def draw_symbols(
    rng: np.random.Generator, layout: Layout, in_head: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.float32]]:
    """Draw symbols: functions by their share in heads, else terminals and the constant, all alike.

    Args:
        rng: source of chance
        layout: of the chromosome
        in_head: whether each symbol is to stand in a head, any shape

    Returns:
        codes and values, constants rounded to four decimals, of the same shape
    """
    primitives, form = layout.primitives, in_head.shape
    nfunction = len(primitives.functions)
    is_function = in_head & (rng.random(form) < layout.function_share)
    codes = rng.integers(nfunction, primitives.constant + 1, form, np.int16)
    codes = np.where(is_function, rng.integers(0, nfunction, form, np.int16), codes)
    drawn = np.round(rng.uniform(-primitives.constant_max, primitives.constant_max, form), 4)
    return codes, np.where(codes == primitives.constant, drawn, 0).astype(np.float32)


def draw_chromosome(rng: np.random.Generator, layout: Layout) -> Chromosome:
    """Draw a chromosome.

    Args:
        rng: source of chance
        layout: what it has in common with all others

    Returns:
        the chromosome
    """
    return Chromosome(*draw_symbols(rng, layout, layout.in_head))


def is_chromosome(layout: Layout, chromosome: Chromosome) -> bool:
    """Return whether the arrays hold a chromosome of this layout: every function in a head, every value finite."""
    codes, values = chromosome.codes, chromosome.values
    primitives, form = layout.primitives, layout.in_head.shape
    if codes.shape != form or values.shape != form or codes.dtype != np.int16 or values.dtype != np.float32:
        return False
    is_function = codes < len(primitives.functions)
    valid = (codes >= 0) & (codes <= primitives.constant) & (layout.in_head | ~is_function)
    return bool(np.all(valid & np.isfinite(values) & ((values == 0) | (codes == primitives.constant))))


def expressed(layout: Layout, chromosome: Chromosome) -> npt.NDArray[np.int64]:
    """Return how many symbols of each gene its expression takes, from its first on, (ngene,)."""
    open_operands = np.cumsum(layout.arities[chromosome.codes] - 1, axis=1)
    ends: npt.NDArray[np.int64] = np.argmax(open_operands == -1, axis=1) + 1
    return ends


def decode(layout: Layout, chromosome: Chromosome) -> Source:
    """Read the genes as expressions, one for each output: the root first, then level by level, left to right.

    Args:
        layout: of the chromosome
        chromosome: the chromosome

    Returns:
        the controller's source

    Source: Ferreira 2001, §3.1.
    """
    lengths = expressed(layout, chromosome).tolist()
    rows = zip(chromosome.codes.tolist(), chromosome.values, lengths, strict=True)
    return Source(tuple(_expression(layout.primitives, codes[:length], values) for codes, values, length in rows))


def _expression(primitives: Primitives, codes: list[int], values: npt.NDArray[np.float32]) -> Expression:
    """Read one gene's expressed symbols: the operands of each stand behind those of all symbols before it."""
    nfunction = len(primitives.functions)
    arities, leaves = primitives.arities, primitives.leaves
    read: list[Expression] = []  # from the last symbol to the one after `at`
    behind = len(codes)  # where the operands of the symbol after `at` begin
    for at in range(len(codes) - 1, -1, -1):
        code = codes[at]
        if code < nfunction:
            end = behind
            behind -= arities[code]
            operands = tuple(read[len(codes) - 1 - operand] for operand in range(behind, end))
            read.append(Apply(primitives.functions[code], operands))
        elif code < primitives.constant:
            read.append(leaves[code - nfunction])
        else:
            read.append(Constant(values[at]))
    return read[-1]


def format_chromosome(layout: Layout, chromosome: Chromosome) -> str:
    """Print a chromosome: a gene a line, symbols apart, a bar between head and tail.

    Args:
        layout: of the chromosome
        chromosome: the chromosome

    Returns:
        the text, which `parse_chromosome` reads back bit for bit
    """
    primitives = layout.primitives
    symbols = (*primitives.functions, *primitives.terminals)
    lines = []
    for codes, values in zip(chromosome.codes.tolist(), chromosome.values, strict=True):
        words = [
            symbols[code] if code < primitives.constant else format_decimal(value)
            for code, value in zip(codes, values, strict=True)
        ]
        lines.append(" ".join([*words[: layout.head], _BAR, *words[layout.head :]]))
    return "\n".join(lines)


def parse_chromosome(layout: Layout, text: str) -> Chromosome:
    """Read a chromosome.

    Args:
        layout: of the chromosome
        text: as `format_chromosome` printed it

    Returns:
        the chromosome

    Raises:
        InputError: the text is no chromosome of this layout
    """
    primitives, length = layout.primitives, layout.head + layout.tail
    code_of = {symbol: code for code, symbol in enumerate((*primitives.functions, *primitives.terminals))}
    rows = [[word for word in line.split() if word != _BAR] for line in text.splitlines()]
    if len(rows) != layout.ngene or any(len(row) != length for row in rows):
        raise InputError(
            f"a chromosome here has {layout.ngene} genes of {length} symbols; give one of a run with the same settings"
        )
    codes = np.full((layout.ngene, length), primitives.constant, np.int16)
    values = np.zeros((layout.ngene, length), np.float32)
    for gene, row in enumerate(rows):
        for at, word in enumerate(row):
            if word in code_of:
                codes[gene, at] = code_of[word]
            else:
                values[gene, at] = _constant(word)
    chromosome = Chromosome(codes, values)
    if not is_chromosome(layout, chromosome):
        raise InputError("a tail holds a function; give a chromosome of a run with the same head")
    return chromosome


def _constant(word: str) -> np.float32:
    """Read a constant."""
    try:
        return parse_decimal(word)
    except (ValueError, OverflowError):
        raise InputError(f"'{word}' is no symbol of this run's chromosomes; give one of the same terminals") from None
