"""The one table of operations: what a controller may compute, and exactly how.

Every back end is held to this table: the Python reference calls `Operation.reference`, the virtual machine's
switch (`runtime/sv_operations.inc`) and the generated C are both written from `Operation.c`. Semantics are IEEE-754
binary32, round to nearest even, every operation rounded, subnormals kept, all NaNs equal.
"""

from __future__ import annotations
