"""The pages of registers are the tables, and the page of rigs says of each servo what they say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from controller.families import FAMILIES, family_of
from controller.products import PRODUCTS
from controller.register_pages import FOLDER, pages
from controller.registers import registers
from controller.servo_law import full_duty_error, position_law

RIGS = (Path(__file__).parent.parent / "docs" / "rigs.md").read_text()


def test_the_pages_are_up_to_date():
    written = {path.name: path.read_text() for path in FOLDER.iterdir()}
    assert written == pages(), "write them anew with `python -m controller.register_pages`"


@pytest.mark.parametrize("product", PRODUCTS.values(), ids=PRODUCTS)
def test_a_page_names_every_register_with_its_source(product):
    rows = [row.split(" | ") for row in pages()[f"{product.name}.md"].splitlines() if re.match(r"\| \d", row)]
    named = {row[2].strip("`") for row in rows if "…" not in row[2]}
    runs = [re.findall(r"`(\w+?)(\d+)`", row[2]) for row in rows if "…" in row[2]]
    for (stem, first), (_, last) in runs:
        named |= {f"{stem}{number}" for number in range(int(first), int(last) + 1)}
    assert named == set(registers(product))
    assert all(row[-1].strip(" |") for row in rows)


@pytest.mark.parametrize("product", PRODUCTS.values(), ids=PRODUCTS)
def test_the_page_of_rigs_tells_a_servo_as_it_is(product):
    row = next(line for line in RIGS.splitlines() if line.startswith(f"| `{product.name}` |"))
    counts = {name: line.initial for name, line in registers(product).items()}
    error = full_duty_error(position_law(product, counts))
    assert f"`{family_of(product).bus_protocol}`" in row
    assert f"| {product.stall_torque_nm:.3g} N m at {product.voltage_v:g} V |".replace("0.6 ", "0.60 ") in row
    assert f"| {product.no_load_speed_rad_s * 30 / 3.141592653589793:.0f} rev/min |" in row
    assert f"| {error:.3f} rad" in row


@pytest.mark.parametrize(
    ("row", "family"),
    [("X330", "dynamixel-x330"), ("X430", "dynamixel-x430"), ("STS, SCS", "feetech-sts"), ("STS, SCS", "feetech-scs")],
)
def test_the_page_of_rigs_tells_each_familys_bit_rates(row, family):
    cells = next(line for line in RIGS.splitlines() if line.startswith(f"| {row} |")).strip("|").split("|")[1:]
    rates = {count: float(cell.replace(" M", "e6")) for count, cell in enumerate(map(str.strip, cells)) if cell != "–"}
    assert rates == FAMILIES[family].bauds


def test_the_page_of_rigs_names_the_registers_that_the_loop_uses():
    rows = {line.split("|")[1].strip(): line.split("|")[2:-1] for line in RIGS.splitlines() if line.startswith("| ")}
    products = [PRODUCTS[name] for name in ("xl430-w250", "ax-12a", "sts3215", "scs0009")]
    for product, ceiling, lock in zip(products, rows["torque ceiling, in RAM"], rows["EEPROM"], strict=True):
        family, table = family_of(product), registers(product)
        told = re.search(r"\((\d+)\)", ceiling)
        assert (int(told[1]) if told else None) == (family.torque_ceiling and table[family.torque_ceiling].address)
        if family.protocol == "feetech":
            assert f"({table[family.lock].address})" in lock
    for product, read in zip(products, rows["reading all servos"], strict=True):
        assert ("sync read" in read) == family_of(product).sync_read
    for product, modes in zip(products, rows["modes of a rig"], strict=True):
        assert {mode.strip() for mode in modes.split(",")} == set(family_of(product).modes)
