"""Products and control tables against independent sources: the vendor SDK's `.model` files and the datasheet."""

import importlib.util
import math
import re
from pathlib import Path

import pytest

from controller.products import PRODUCTS
from controller.registers import registers

# where the SDK's own files disagree with each other, and what the registers' `source` says about it
OLDER_INDIRECT_DATA = 224


X330 = [product.name for product in PRODUCTS.values() if product.family == "dynamixel-x330"]
X = [product for product in PRODUCTS.values() if product.family in ("dynamixel-x330", "dynamixel-x430")]


def model_file(name):
    spec = importlib.util.find_spec("dynamixel_easy_sdk")
    text = (Path(spec.submodule_search_locations[0]) / "control_table" / f"{name}.model").read_text()
    table = {}
    for line in text.partition("[control table]")[2].splitlines()[2:]:
        fields = line.split("\t")
        if len(fields) == 3 and not re.search("Write|Read", fields[2]):
            table[snake(fields[2])] = (int(fields[0]), int(fields[1]))
    units = dict(re.findall(r"^(Present Velocity|value_of_zero_radian_position)\t([0-9.]+)", text, re.M))
    return table, units


def snake(name):
    return name.replace("(Shadow)", "").lower().replace(" ", "_")


@pytest.mark.parametrize("product", X330)
@pytest.mark.parametrize("firmware", ["", "_fw52"])
def test_addresses_and_sizes_agree_with_the_sdk(product, firmware):
    table, _ = model_file(product.replace("-", "_") + firmware)
    lines = registers(PRODUCTS[product])
    assert len(table) > 50
    if not firmware:
        # the one conflict: the file for older firmware has the indirect data elsewhere than manual and newer file
        assert table.pop("indirect_data_1") == (OLDER_INDIRECT_DATA, 1)
        assert str(OLDER_INDIRECT_DATA) in lines["indirect_data_1"].source
    assert {name: (lines[name].address, lines[name].size) for name in table} == table


@pytest.mark.parametrize("product", X330)
def test_registers_that_the_sdk_does_not_list_say_so(product):
    table, _ = model_file(product.replace("-", "_") + "_fw52")
    extra = {name: line for name, line in registers(PRODUCTS[product]).items() if name not in table}
    numbered = {name for name in extra if re.fullmatch(r"indirect_(address|data)_([2-9]|1[0-9]|20)", name)}
    assert len(numbered) == 38
    assert {name for name in extra if "not in the SDK" in extra[name].source} == set(extra) - numbered


@pytest.mark.parametrize("product", X, ids=lambda product: product.name)
def test_units_agree_with_the_sdk(product):
    _, units = model_file(product.name.replace("-", "_"))
    assert product.velocity_unit_rad_s == float(units["Present Velocity"])
    assert product.center_tick == int(units["value_of_zero_radian_position"])
    # the manual's unit is this one, rounded to three digits
    assert round(product.velocity_unit_rad_s * 60.0 / (2.0 * math.pi), 3) == 0.229
    assert registers(product)["present_velocity"].scale == product.velocity_unit_rad_s


@pytest.mark.parametrize("product", PRODUCTS.values(), ids=PRODUCTS)
def test_registers_do_not_overlap_and_initial_values_fit(product):
    end = 0
    first_ram = registers(product)["torque_enable"].address
    for line in registers(product).values():
        assert line.address >= end, line.name
        end = line.address + line.size
        bits = 8 * line.size
        smallest, largest = (-(1 << bits - 1), (1 << bits - 1) - 1) if line.signed else (0, (1 << bits) - 1)
        if line.sign_bit is not None:
            largest = (1 << line.sign_bit) - 1
            smallest = -largest
        assert smallest <= line.low <= line.high <= largest, line.name
        if line.access == "rw":
            assert line.low <= line.initial <= line.high, line.name
        indirect = line.name.startswith("indirect_")
        assert line.eeprom == (line.address < first_ram and not indirect), line.name
    assert registers(product)["model_number"].initial == product.model_number


@pytest.mark.parametrize(("name", "error_rad"), [("xc330-m181", 0.145), ("xl330-m288", 0.43)])
def test_factory_gain_gives_full_pwm_at_the_published_error(name, error_rad):
    product = PRODUCTS[name]
    gain = registers(product)["position_p_gain"].initial
    ticks = product.duty_full / (gain / product.p_divisor)
    assert ticks * 2.0 * math.pi / product.ticks_per_turn == pytest.approx(error_rad, rel=0.02)


@pytest.mark.parametrize(
    ("name", "model", "stall_nm", "amperes", "rev_min", "grams"),
    [("xc330-m181", 1230, 0.60, 1.80, 129, 23), ("xl330-m288", 1200, 0.52, 1.47, 103, 18)],
)
def test_datasheet_numbers_at_five_volts(name, model, stall_nm, amperes, rev_min, grams):
    product = PRODUCTS[name]
    assert (product.model_number, product.voltage_v) == (model, 5.0)
    assert (product.stall_torque_nm, product.stall_current_a) == (stall_nm, amperes)
    assert product.no_load_speed_rad_s == pytest.approx(rev_min * math.pi / 30.0)
    assert product.mass_kg == pytest.approx(grams * 1e-3)
