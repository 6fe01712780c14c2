"""How many cycles instructions take: the tables of the cores' technical reference manuals.

Source: Arm Cortex-M4 TRM (DDI 0439), tables 3-1 (instruction set summary) and 7-1 (FPU); Arm Cortex-M0 TRM (DDI 0432),
table 3-1. Where a manual gives a range, this is its upper end: a pipeline refill takes 3 cycles, a division 12.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from controller.errors import RunError
from firmware_gen.bounds.machine_code import Instruction

_CONDITIONS: Final = "(?:eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le|al)"
_FPU_ARITHMETIC: Final = frozenset(
    {"vadd", "vsub", "vmul", "vnmul", "vdiv", "vsqrt", "vmla", "vmls", "vfma", "vfms", "vcvt", "vcmp", "vcmpe"}
)


@dataclass(frozen=True)
class CycleTable:
    """Hold what one core takes.

    Args:
        source: where the numbers come from
        plain: cycles by mnemonic without condition and width
        branch: added where a branch is taken
        call: added by a call
        leave: added by a pop that returns
        multiply: cycles of the small multiplier, where the core may have one
        forwarding: added where the next instruction uses the result of an arithmetic FPU instruction
    """

    source: str
    plain: Mapping[str, int]
    branch: int
    call: int
    leave: int
    multiply: int
    forwarding: int


def _table(**groups: str) -> Mapping[str, int]:
    """Return cycles by mnemonic; keys are as "c2", two cycles."""
    return MappingProxyType({name: int(key[1:]) for key, names in groups.items() for name in names.split()})


_ONE: Final = (
    "mov movs movw movt mvn mvns add adds addw adc adcs sub subs subw sbc sbcs rsb rsbs neg negs cmp cmn tst teq and "
    "ands eor eors orr orrs orn orns bic bics lsl lsls lsr lsrs asr asrs ror rors rrx rrxs clz rbit rev rev16 revsh "
    "sxtb sxth uxtb uxth ubfx sbfx bfi bfc nop it itt ite ittt itte itet itee itttt ittte ittet ittee itett itete "
    "iteet iteee adr b cbz cbnz bx bl blx mul muls"
)
_LOADS: Final = "ldr ldrb ldrh ldrsb ldrsh str strb strh"

CORTEX_M4F: Final = CycleTable(
    source="Arm Cortex-M4 TRM (DDI 0439), tables 3-1 and 7-1",
    plain=_table(
        c1=f"{_ONE} mla mls smull umull smlal umlal vadd vsub vmul vnmul vneg vabs vcmp vcmpe vcvt vmov vmrs vmsr",
        c2=f"{_LOADS} vldr vstr",
        c3="ldrd strd vmla vmls vfma vfms vnmla vnmls",
        c12="sdiv udiv",
        c14="vdiv vsqrt",
    ),
    branch=3,
    call=3,
    leave=3,
    multiply=1,
    forwarding=1,
)

CORTEX_M0: Final = CycleTable(
    source="Arm Cortex-M0 TRM (DDI 0432), table 3-1",
    plain=_table(c1=_ONE, c2=_LOADS),
    branch=2,
    call=3,
    leave=3,
    multiply=32,
    forwarding=0,
)


def base_mnemonic(instruction: Instruction, plain: Mapping[str, int]) -> str:
    """Return a mnemonic without width, types and condition.

    Args:
        instruction: the instruction
        plain: the mnemonics that a core knows
    """
    text = instruction.mnemonic.partition(".")[0]
    if text in plain or text in _LISTS:
        return text
    bare = re.sub(f"{_CONDITIONS}$", "", text)
    return bare if bare in plain or bare in _LISTS or not bare else text


_LISTS: Final = frozenset({"push", "pop", "ldm", "ldmia", "ldmdb", "stm", "stmia", "stmdb", "vpush", "vpop"}) | {
    "vldm",
    "vldmia",
    "vldmdb",
    "vstm",
    "vstmia",
    "vstmdb",
}


def is_conditional(instruction: Instruction) -> bool:
    """Return whether an instruction's mnemonic ends in a condition.

    Args:
        instruction: a branch or a return
    """
    text = instruction.mnemonic.partition(".")[0]
    return bool(re.fullmatch(f"(?:b|bx|pop|ldmia|ldr|mov){_CONDITIONS}", text)) and text != "ldmia"


def register_count(operands: str) -> int:
    """Return how many registers a list such as "{r4, r5-r7, pc}" names.

    Args:
        operands: of an instruction with a list
    """
    count = 0
    for part in operands.partition("{")[2].partition("}")[0].split(","):
        ends = re.findall(r"\d+", part)
        count += int(ends[1]) - int(ends[0]) + 1 if "-" in part else 1
    return count


def instruction_cycles(
    table: CycleTable, instruction: Instruction, following: Instruction | None, taken: bool, slow_multiply: bool
) -> int:
    """Return the cycles of an instruction from memory without wait states, at most.

    Args:
        table: of the core
        instruction: the instruction
        following: the one that is executed next, or None where that is not known
        taken: it is a branch, a call or a return that is taken
        slow_multiply: the core has the small multiplier

    Raises:
        RunError: the table does not know it
    """
    name = base_mnemonic(instruction, table.plain)
    if name in _LISTS:
        words = register_count(instruction.operands)
        return 1 + words + (table.leave if taken else 0)
    if name not in table.plain:
        raise RunError(f"no cycle count is known for '{instruction.mnemonic}'; bound this controller by measuring")
    cycles = table.plain[name]
    if name in ("mul", "muls") and slow_multiply:
        cycles = table.multiply
    if name == "vmov" and len(re.findall(r"\br\d+\b", instruction.operands)) > 1:
        cycles = 2
    if taken:
        cycles += table.call if name in ("bl", "blx") else table.branch
    if name in _FPU_ARITHMETIC and _forwards(instruction, name, following):
        cycles += table.forwarding
    return cycles


def _forwards(instruction: Instruction, name: str, following: Instruction | None) -> bool:
    if following is None:
        return True
    if name in ("vcmp", "vcmpe"):
        return following.mnemonic.startswith("vmrs")
    result = instruction.operands.partition(",")[0].strip()
    return bool(re.search(rf"\b{result}\b", following.operands))
