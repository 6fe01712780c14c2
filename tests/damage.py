"""Damage to bytes on a line: bits flipped, bytes lost and bytes between."""

from hypothesis import strategies as st


def damages(size_max, most):
    """Draw what is done to bytes: kind, place and value of each change.

    Args:
        size_max: places are below it
        most: changes at most
    """
    kinds = st.sampled_from(["flip", "drop", "insert"])
    return st.lists(st.tuples(kinds, st.integers(0, size_max - 1), st.integers(0, 255)), max_size=most)


def damaged(wire, damage):
    """Return bytes with changes made in turn; no bytes stay none."""
    wire = bytearray(wire)
    for kind, place, value in damage:
        if wire:
            at = place % len(wire)
            if kind == "flip":
                wire[at] ^= 1 << value % 8
            elif kind == "drop":
                del wire[at]
            else:
                wire.insert(at, value)
    return bytes(wire)
