"""Products and control tables against independent sources: the vendor SDK's `.model` files and the datasheet."""

import csv
import importlib.util
import math
import re
from dataclasses import fields
from pathlib import Path

import pytest
import scservo_sdk
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.families import FAMILIES, family_of
from controller.products import PRODUCTS
from controller.registers import decode_register, encode_register, registers

# where the SDK's own files disagree with each other, and what the registers' `source` says about it
OLDER_INDIRECT_DATA = 224


X = [product for product in PRODUCTS.values() if product.family in ("dynamixel-x330", "dynamixel-x430")]
MODEL_FILES = [
    ("xl330-m288", ""),
    ("xl330-m288", "_fw52"),
    ("xc330-m181", ""),
    ("xc330-m181", "_fw52"),
    ("xl430-w250", ""),
    ("xm430-w350", ""),
]


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


@pytest.mark.parametrize(("product", "firmware"), MODEL_FILES)
def test_addresses_and_sizes_agree_with_the_sdk(product, firmware):
    table, _ = model_file(product.replace("-", "_") + firmware)
    lines = registers(PRODUCTS[product])
    assert len(table) > 45
    if PRODUCTS[product].family == "dynamixel-x330" and not firmware:
        # the one conflict: the file for older firmware has the indirect data elsewhere than manual and newer file
        assert table.pop("indirect_data_1") == (OLDER_INDIRECT_DATA, 1)
        assert str(OLDER_INDIRECT_DATA) in lines["indirect_data_1"].source
    assert {name: (lines[name].address, lines[name].size) for name in table} == table


@pytest.mark.parametrize(("product", "firmware"), [row for row in MODEL_FILES if row[1] or "430" in row[0]])
def test_registers_that_the_sdk_does_not_list_say_so(product, firmware):
    table, _ = model_file(product.replace("-", "_") + firmware)
    extra = {name: line for name, line in registers(PRODUCTS[product]).items() if name not in table}
    numbered = {name for name in extra if re.fullmatch(r"indirect_(address|data)_\d+", name)}
    assert len(numbered) == (110 if "430" in product else 38)
    assert {name for name in extra if "not in the SDK" in extra[name].source} == set(extra) - numbered


def test_the_second_run_of_indirect_registers_is_where_the_sdk_has_it():
    spec = importlib.util.find_spec("dynamixel_easy_sdk")
    folder = Path(spec.submodule_search_locations[0]) / "control_table"
    for product in ("xl430-w250", "xm430-w350"):
        text = (folder / f"{product.replace('-', '_')}.model").read_text()
        table = registers(PRODUCTS[product])
        for name, register in (("Address", "indirect_address_29"), ("Data", "indirect_data_29")):
            place = re.search(rf"^(\d+)\t(\d)\tIndirect {name} Read", text, re.M)
            assert (table[register].address, table[register].size) == (int(place[1]), int(place[2]))


# what a program has and our tables, after Feetech's own memory tables, have not
FEETECH_CONFLICTS = {("scs", "present_current"), ("scs", "acceleration")}


@pytest.mark.parametrize(("series", "names"), [("sts", ("sts3215", "sts3215-7v4")), ("scs", ("scs0009",))])
def test_addresses_and_sizes_agree_with_feetechs_sdks(series, names):
    golden = (Path(__file__).parent / "golden" / "feetech-memory.csv").read_text().splitlines()
    rows = [row for row in csv.DictReader(line for line in golden if line[0] != "#") if row["series"] == series]
    assert len(rows) > 50
    for name in names:
        lines = registers(PRODUCTS[name])
        for row in rows:
            if (series, row["register"]) in FEETECH_CONFLICTS:
                assert row["register"] not in lines
                assert any(f"at {row['address']}" in line.source for line in lines.values())
                continue
            line = lines[row["register"]]
            assert (line.address, line.size) == (int(row["address"]), int(row["size"])), row
        # nothing is left that none of them knows, but for what one series' table has and the programs do not name
        unknown = set(lines) - {row["register"] for row in rows}
        assert unknown == ({"async_flag"} if series == "sts" else {"overload_torque"})


@pytest.mark.parametrize(
    "product", [p for p in PRODUCTS.values() if p.family.startswith("feetech")], ids=lambda p: p.name
)
@given(st.data())
@settings(max_examples=60, derandomize=True, deadline=None)
def test_counts_are_written_as_feetechs_sdk_writes_them(product, data):
    line = data.draw(st.sampled_from([line for line in registers(product).values() if line.size == 2]))
    value = data.draw(st.integers(line.low, line.high))
    end = scservo_sdk.SCS_GETEND()
    scservo_sdk.SCS_SETEND(1 if product.name == "scs0009" else 0)
    try:
        word = scservo_sdk.SCS_TOSCS(value, line.sign_bit) if line.signed else value
        expected = bytes([scservo_sdk.SCS_LOBYTE(word), scservo_sdk.SCS_HIBYTE(word)])
    finally:
        scservo_sdk.SCS_SETEND(end)
    assert encode_register(line, value) == expected
    assert decode_register(line, expected) == value


@pytest.mark.parametrize(
    ("product", "name", "data", "count"),
    [
        # e-Manual: a load of 512 works counter-clockwise, 1024 and more clockwise, 1024 equals 0
        ("ax-12a", "present_load", "0002", 512),
        ("ax-12a", "present_load", "0006", -512),
        ("ax-12a", "present_load", "0004", 0),
        ("ax-12a", "goal_position", "ff03", 1023),
        # e-Manual, protocol 2.0: 166 as A6 00 00 00
        ("xl430-w250", "present_position", "a6000000", 166),
        ("xl430-w250", "homing_offset", "ffffffff", -1),
        ("xl430-w250", "present_load", "18fc", -1000),
        ("sts3215", "model_number", "0903", 777),
        ("scs0009", "model_number", "0504", 1284),
        ("sts3215", "present_position", "0180", -1),
        ("sts3215", "homing_offset", "010c", -1025),
    ],
)
def test_bytes_of_the_manuals(product, name, data, count):
    line = registers(PRODUCTS[product])[name]
    assert decode_register(line, bytes.fromhex(data)) == count
    if count or not line.signed:
        assert encode_register(line, count) == bytes.fromhex(data)


@pytest.mark.parametrize("product", PRODUCTS.values(), ids=PRODUCTS)
def test_a_count_that_does_not_fit_is_refused(product):
    for line in registers(product).values():
        bits = 8 * line.size if line.sign_bit is None else line.sign_bit
        bits -= line.encoding == "twos"
        assert decode_register(line, encode_register(line, line.high)) == line.high
        with pytest.raises(ValueError, match=line.name):
            encode_register(line, 1 << bits)
        with pytest.raises(ValueError, match=line.name):
            encode_register(line, -(1 << bits) - 1 if line.signed else -1)


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


@pytest.mark.parametrize(
    ("name", "model", "volts", "stall_nm", "amperes", "rev_min", "grams"),
    [
        ("xl430-w250", 1060, 11.1, 1.4, 1.3, 57, 57.2),
        ("xm430-w350", 1020, 12.0, 4.1, 2.3, 46, 82),
        ("ax-12a", 12, 12.0, 1.5, 1.5, 59, 54.6),
        ("sts3215", 777, 12.0, 30 * 0.0980665, 2.7, 60 / (6 * 0.222), 55),
        ("sts3215-7v4", 777, 7.4, 19.5 * 0.0980665, 2.7, 52, 55),
        ("scs0009", 1284, 6.0, 2.3 * 0.0980665, 1.0, 100, 13),
    ],
)
def test_datasheet_numbers_at_rated_voltage(name, model, volts, stall_nm, amperes, rev_min, grams):
    product = PRODUCTS[name]
    assert (product.model_number, product.voltage_v, product.stall_current_a) == (model, volts, amperes)
    assert product.stall_torque_nm == pytest.approx(stall_nm, rel=2e-3)
    assert product.no_load_speed_rad_s == pytest.approx(rev_min * math.pi / 30.0, rel=2e-3)
    assert product.mass_kg == pytest.approx(grams * 1e-3)


@pytest.mark.parametrize("product", PRODUCTS.values(), ids=PRODUCTS)
def test_a_family_names_registers_that_its_servos_have(product):
    family, lines = family_of(product), registers(product)
    assert family_of(product) is family
    singles = [getattr(family, field.name) for field in fields(family)]
    named = {value for value in singles if isinstance(value, str)} - {
        *(family.name, family.protocol, family.bus_protocol, family.byte_order, family.ceiling_key)
    }
    named |= {*family.position_limits, *family.voltage_limits, *family.state, *dict(family.settings)}
    named |= {name for block in family.health for name in block}
    named |= {name for gains in family.gains.values() for names in gains.values() for name in names}
    assert named <= set(lines)
    assert set(family.gains) == set(family.modes)
    assert all(lines[name].low <= count <= lines[name].high for name, count in family.settings)
    assert lines[family.model_number].initial == product.model_number
    assert {lines[family.baud_rate].initial} <= set(family.bauds)
    assert {line.byte_order for line in lines.values()} == {family.byte_order}
    first, last = (lines[name] for name in family.state)
    block = {line.name for line in lines.values() if first.address <= line.address <= last.address}
    assert block == {family.position, family.velocity, family.load}


def test_families_share_no_name_and_every_one_has_a_servo():
    assert {product.family for product in PRODUCTS.values()} == set(FAMILIES)
