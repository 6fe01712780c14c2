"""Operators of gene expression programming: every one gives chromosomes whose tails hold no functions.

`insert` and `exchange` say what happens, the others draw where. A sequence counts its symbols through the whole
chromosome, from the first gene's first on; a bond is the place before a symbol.

Source: Ferreira 2001, §5.
"""

from __future__ import annotations

import numpy as np

from evolve.gep.chromosome import Chromosome, Layout, draw_symbols, expressed
from evolve.gp.variation import nudge


def mutate(rng: np.random.Generator, layout: Layout, parent: Chromosome, rate: float) -> Chromosome | None:
    """Draw symbols anew, each with the same chance: any symbol in a head, terminals and constants in a tail.

    A symbol may come out as it was.

    Args:
        rng: source of chance
        layout: of the chromosomes
        parent: what varies
        rate: chance of each symbol

    Returns:
        the child, None: no symbol was drawn

    Source: Ferreira 2001, §5.2.
    """
    where = rng.random(parent.codes.shape) < rate
    if not where.any():
        return None
    codes, values = parent.codes.copy(), parent.values.copy()
    codes[where], values[where] = draw_symbols(rng, layout, layout.in_head[where])
    return Chromosome(codes, values)


def insert(layout: Layout, parent: Chromosome, start: int, length: int, gene: int, site: int) -> Chromosome:
    """Copy a sequence into a head: what stood there moves on, the head's last symbols are lost, the tail stays.

    Args:
        layout: of the chromosomes
        parent: what varies
        start: first symbol of the sequence, 0 to the chromosome's length
        length: symbols of the sequence; what does not fit the head is left out
        gene: whose head, from 0
        site: bond of the head where the sequence begins, 0 is the root

    Returns:
        the child
    """
    codes, values = parent.codes.copy(), parent.values.copy()
    for child, old in ((codes, parent.codes), (values, parent.values)):
        sequence = old.reshape(-1)[start : start + length]
        head = np.concatenate((old[gene, :site], sequence, old[gene, site : layout.head]))
        child[gene, : layout.head] = head[: layout.head]
    return Chromosome(codes, values)


def transpose(rng: np.random.Generator, layout: Layout, parent: Chromosome, length_max: int) -> Chromosome | None:
    """Copy a sequence from anywhere into a head, not to its root: an insertion sequence (IS).

    Args:
        rng: source of chance
        layout: of the chromosomes
        parent: what varies
        length_max: symbols of the longest sequence; lengths are drawn evenly

    Returns:
        the child, None: a head of one symbol has no place but the root

    Source: Ferreira 2001, §5.3.1.
    """
    if layout.head < 2:
        return None
    length = int(rng.integers(1, min(length_max, parent.codes.size) + 1))
    start = int(rng.integers(parent.codes.size - length + 1))
    return insert(layout, parent, start, length, int(rng.integers(layout.ngene)), int(rng.integers(1, layout.head)))


def transpose_to_root(
    rng: np.random.Generator, layout: Layout, parent: Chromosome, length_max: int
) -> Chromosome | None:
    """Copy a sequence that begins with a function in a head to the root of the same gene (RIS).

    A place in the head is drawn; the sequence begins at the first function from there on.

    Args:
        rng: source of chance
        layout: of the chromosomes
        parent: what varies
        length_max: symbols of the longest sequence; lengths are drawn evenly

    Returns:
        the child, None: there is no function from the place on

    Source: Ferreira 2001, §5.3.2.
    """
    gene, place = int(rng.integers(layout.ngene)), int(rng.integers(layout.head))
    is_function = parent.codes[gene, place : layout.head] < len(layout.primitives.functions)
    if not is_function.any():
        return None
    at = place + int(is_function.argmax())
    length = min(int(rng.integers(1, length_max + 1)), layout.head + layout.tail - at)
    return insert(layout, parent, gene * (layout.head + layout.tail) + at, length, gene, 0)


def transpose_gene(rng: np.random.Generator, layout: Layout, parent: Chromosome) -> Chromosome | None:
    """Move a gene to the front; those before it move one back, so that all these outputs change their expressions.

    Args:
        rng: source of chance
        layout: of the chromosomes
        parent: what varies

    Returns:
        the child, None: there is one gene only

    Source: Ferreira 2001, §5.3.3.
    """
    if layout.ngene < 2:
        return None
    return move_to_front(parent, int(rng.integers(1, layout.ngene)))


def move_to_front(parent: Chromosome, gene: int) -> Chromosome:
    """Move a gene to the front.

    Args:
        parent: what varies
        gene: which, from 0

    Returns:
        the child
    """
    order = [gene, *range(gene), *range(gene + 1, len(parent.codes))]
    return Chromosome(parent.codes[order], parent.values[order])


def exchange(mother: Chromosome, father: Chromosome, begin: int, end: int) -> tuple[Chromosome, Chromosome]:
    """Exchange what stands between two bonds.

    Args:
        mother: one parent
        father: the other
        begin: first symbol that is exchanged
        end: the symbol after the last one

    Returns:
        the mother with the father's symbols there, and the father with the mother's
    """
    return _graft(mother, father, begin, end), _graft(father, mother, begin, end)


def _graft(receiver: Chromosome, donor: Chromosome, begin: int, end: int) -> Chromosome:
    """Return the receiver with the donor's symbols from `begin` to `end`."""
    codes, values = receiver.codes.copy(), receiver.values.copy()
    codes.reshape(-1)[begin:end] = donor.codes.reshape(-1)[begin:end]
    values.reshape(-1)[begin:end] = donor.values.reshape(-1)[begin:end]
    return Chromosome(codes, values)


def recombine_at_one_point(
    rng: np.random.Generator, layout: Layout, mother: Chromosome, father: Chromosome
) -> tuple[Chromosome, Chromosome]:
    """Exchange what stands behind a bond, anywhere in the chromosome.

    Args:
        rng: source of chance
        layout: of the chromosomes
        mother: one parent
        father: the other

    Returns:
        two children, each one parent before the bond and the other behind it

    Source: Ferreira 2001, §5.4.1.
    """
    size = layout.in_head.size
    return exchange(mother, father, int(rng.integers(1, size)), size)


def recombine_at_two_points(
    rng: np.random.Generator, layout: Layout, mother: Chromosome, father: Chromosome
) -> tuple[Chromosome, Chromosome]:
    """Exchange what stands between two bonds, anywhere in the chromosome.

    Args:
        rng: source of chance
        layout: of the chromosomes
        mother: one parent
        father: the other

    Returns:
        two children, each one parent outside the bonds and the other between them

    Source: Ferreira 2001, §5.4.2.
    """
    begin, end = sorted(rng.integers(1, layout.in_head.size, 2).tolist())
    return exchange(mother, father, begin, end)


def recombine_genes(
    rng: np.random.Generator, layout: Layout, mother: Chromosome, father: Chromosome
) -> tuple[Chromosome, Chromosome]:
    """Exchange one gene, that of the same output in both.

    Args:
        rng: source of chance
        layout: of the chromosomes
        mother: one parent
        father: the other

    Returns:
        two children, each one parent but for a gene of the other

    Source: Ferreira 2001, §5.4.3.
    """
    gene, length = int(rng.integers(layout.ngene)), layout.head + layout.tail
    return exchange(mother, father, gene * length, (gene + 1) * length)


def mutate_constants(rng: np.random.Generator, layout: Layout, parent: Chromosome, rate: float) -> Chromosome | None:
    """Draw constants anew, each with the same chance, expressed or not.

    Args:
        rng: source of chance
        layout: of the chromosomes
        parent: what varies
        rate: chance of each constant

    Returns:
        the child, None: no constant was drawn
    """
    where = (parent.codes == layout.primitives.constant) & (rng.random(parent.codes.shape) < rate)
    count = int(np.count_nonzero(where))
    if not count:
        return None
    values = parent.values.copy()
    values[where] = np.round(rng.uniform(-layout.primitives.constant_max, layout.primitives.constant_max, count), 4)
    return Chromosome(parent.codes, values)


def tune_constant(rng: np.random.Generator, layout: Layout, parent: Chromosome) -> Chromosome | None:
    """Move one expressed constant a little.

    Args:
        rng: source of chance
        layout: of the chromosomes
        parent: what varies

    Returns:
        the child, None: no constant is expressed
    """
    is_expressed = np.arange(parent.codes.shape[1]) < expressed(layout, parent)[:, None]
    places = np.flatnonzero((parent.codes == layout.primitives.constant) & is_expressed)
    if not len(places):
        return None
    at = int(places[rng.integers(len(places))])
    values = parent.values.copy()
    values.reshape(-1)[at] = nudge(rng, layout.primitives, float(parent.values.reshape(-1)[at]))
    return Chromosome(parent.codes, values)
