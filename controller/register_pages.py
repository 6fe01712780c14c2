"""Write `docs/registers/`, the control tables as pages; run as ``python -m controller.register_pages``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Final

from controller import registers_ax, registers_feetech, registers_x
from controller.families import family_of
from controller.products import PRODUCTS, Product
from controller.register import Register
from controller.registers import registers
from controller.servo_law import full_duty_error, position_law

FOLDER: Final = Path(__file__).resolve().parent.parent / "docs" / "registers"

_NOTE: Final = "Written by `python -m controller.register_pages`; `make test` holds it to the table in `controller/`."
_ENCODINGS: Final = {
    "unsigned": "unsigned",
    "twos": "two's complement",
    "sign15": "magnitude, sign in bit 15",
    "sign11": "magnitude, sign in bit 11",
    "sign10": "magnitude, sign in bit 10",
}
_HEAD: Final = (
    "| address | size | register | access | encoding | unit | range | initial | source |",
    "|---|---|---|---|---|---|---|---|---|",
)


def pages() -> dict[str, str]:
    """Return the text of every page by its file's name: one a product, and the index."""
    texts = {f"{product.name}.md": _product_page(product) for product in PRODUCTS.values()}
    return {"README.md": _index(), **texts}


def _index() -> str:
    rows = [
        f"| [`{product.name}`]({product.name}.md) | {product.model_number} | {family_of(product).bus_protocol} "
        f"| {family_of(product).byte_order} | {_full_duty(product)} |"
        for product in PRODUCTS.values()
    ]
    sources = {**registers_x.SOURCES, **registers_ax.SOURCES, **registers_feetech.SOURCES}
    return _text(
        "# Registers of the servos",
        "",
        _NOTE,
        "",
        "| product | model number | protocol | first byte | full duty at factory gains |",
        "|---|---|---|---|---|",
        *rows,
        "",
        "An initial count is the factory's in the EEPROM, and what a servo holds after power-up in the RAM. A count",
        "times the unit is SI. `E` is the EEPROM, which X series servos lock while torque is on, and others with their",
        "`lock`; `R` is the RAM. STS servos have bytes of the factory's own from 80 on.",
        "",
        "Each line's last column says where it comes from, and who says otherwise:",
        "",
        *(f"- {tag} {text}" for tag, text in sources.items()),
    )


def _product_page(product: Product) -> str:
    family = family_of(product)
    facts = (
        f"Model number {product.model_number}, {family.bus_protocol}, {family.byte_order} endian, "
        f"{'with' if family.sync_read else 'no'} sync read.",
        "",
        "| | |",
        "|---|---|",
        f"| stall | {product.stall_torque_nm:g} N m, {product.stall_current_a:g} A at {product.voltage_v:g} V |",
        f"| no-load speed | {product.no_load_speed_rad_s:.3g} rad/s at {product.voltage_v:g} V |",
        f"| encoder | {product.ticks_per_turn:g} counts a turn, 0 to {product.count_max} |",
        f"| mass | {1e3 * product.mass_kg:g} g |",
        f"| play of the gears | {product.backlash_rad:.3g} rad |",
        f"| rotor inertia at the output | {product.armature_kg_m2:g} kg m² |",
        f"| friction at the output | {product.friction_loss_nm:g} N m, {product.damping_nms_rad:g} N m s/rad |",
        f"| full duty at factory gains | {_full_duty(product)} |",
        "",
        f"Source: {product.source}.",
    )
    return _text(f"# Registers of the {product.name}", "", _NOTE, "", *facts, "", *_HEAD, *_rows(product))


def _rows(product: Product) -> Iterator[str]:
    """Yield a line for every register, one for each run of numbered ones."""
    lines = registers(product).values()
    for _, run in groupby(enumerate(lines), lambda item: _run_key(*item)):
        first, *more = [line for _, line in run]
        last = more[-1] if more else first
        yield _row(first, last)


def _run_key(place: int, line: Register) -> tuple[str, int, int]:
    """Return what numbered registers have in common that follow each other."""
    number = re.fullmatch(r"(indirect_\w+_)(\d+)", line.name)
    return (number[1], place - int(number[2]), line.size) if number else (line.name, 0, line.size)


def _row(first: Register, last: Register) -> str:
    several = last is not first
    name = f"`{first.name}` … `{last.name}`" if several else f"`{first.name}`"
    address = f"{first.address} … {last.address}" if several else f"{first.address}"
    initial = f"{first.initial} … {last.initial}" if several and first.initial != last.initial else f"{first.initial}"
    unit = "" if first.unit == "1" else f"{first.scale:.4g} {first.unit}"
    access = f"{'E' if first.eeprom else 'R'} {first.access}"
    span = f"{first.low} … {first.high}"
    cells = (address, str(first.size), name, access, _ENCODINGS[first.encoding], unit, span, initial, first.source)
    return f"| {' | '.join(cells)} |"


def _full_duty(product: Product) -> str:
    counts = {name: line.initial for name, line in registers(product).items()}
    return f"{full_duty_error(position_law(product, counts)):.3f} rad"


def _text(*lines: str) -> str:
    return "\n".join(lines) + "\n"


def main() -> int:
    """Write the pages.

    Returns:
        exit status
    """
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    sys.stderr.write(f"wrote {FOLDER}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
