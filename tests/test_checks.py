"""The start-up check on servos of every family: what it says, and which register it would have to be."""

import pytest
from rig_bench import Bench

from controller import load_rig, registers
from deploy.buses.line_time import period_line_s

RIGS = {name: load_rig(name) for name in ("lamp-xc330", "lamp-xl430", "lamp-sts3215", "lamp-ax12")}


@pytest.fixture(scope="module")
def benches(tmp_path_factory):
    """Return one rig of each family; what a test changes it puts back."""
    return {name: Bench(tmp_path_factory.mktemp(name), rig=rig) for name, rig in RIGS.items()}


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_as_its_file_says_gives_no_error(benches, name):
    on = benches[name]
    outcome = on.run(arm=False)
    assert outcome.done and [f.text for f in outcome.findings if f.level == "error"] == []
    assert on.written() == []


FINDINGS = [
    ("lamp-xl430", "return_delay_time", 250, 0, "return_delay_time is 500 us, the rig says 0 us; set register 9 to 0"),
    ("lamp-xl430", "operating_mode", 4, 3, "operating_mode is 4 and must be 3; set register 11 to 3"),
    ("lamp-xl430", "max_position_limit", 2100, None, "max_position_limit 2100 cuts off travel; set register 48 to"),
    (
        "lamp-xl430",
        "max_voltage_limit",
        110,
        140,
        "max_voltage_limit is 11 V, the rig's supply 11.1 V; set register 32",
    ),
    ("lamp-sts3215", "return_delay", 5, 0, "return_delay is 10 us, the rig says 0 us; set register 7 to 0"),
    ("lamp-sts3215", "p_coefficient", 32, 50, "p_coefficient is 32, the rig says 50; set register 21 to 50"),
    ("lamp-sts3215", "d_coefficient", 32, 0, "d_coefficient is 32, the rig says 0; set register 22 to 0"),
    ("lamp-sts3215", "operating_mode", 3, 0, "operating_mode is 3 and must be 0; set register 33 to 0"),
    ("lamp-sts3215", "phase", 28, 12, "phase 28 counts angles over several turns; set register 18 to 12"),
    ("lamp-sts3215", "max_torque", 500, 1000, "max_torque 500 is below the rig's 1000; set register 16"),
    ("lamp-sts3215", "max_angle_limit", 0, None, "max_angle_limit 0 cuts off travel; set register 11 to"),
    ("lamp-sts3215", "max_voltage_limit", 80, 140, "max_voltage_limit is 8 V, the rig's supply 12 V; set register 14"),
    ("lamp-ax12", "return_delay_time", 250, 0, "return_delay_time is 500 us, the rig says 0 us; set register 5 to 0"),
    ("lamp-ax12", "ccw_angle_limit", 0, None, "ccw_angle_limit 0 cuts off travel; set register 8 to"),
    ("lamp-ax12", "max_torque", 500, 1023, "max_torque 500 is below the rig's 1023; set register 14"),
]


@pytest.mark.parametrize(("name", "register", "held", "want", "sentence"), FINDINGS)
def test_each_setting_that_is_wrong_is_a_sentence_and_a_fix(benches, name, register, held, want, sentence):
    on = benches[name]
    table = on.virtual.servos[1].table
    before, table[register] = table[register], held
    try:
        outcome = on.run(arm=False)
    finally:
        table[register] = before
    assert outcome.faulty and "joint a1 (servo 2): " + sentence in outcome.reason
    fixes = [finding.fix for finding in outcome.findings if finding.fix]
    (fix,) = [fix for fix in fixes if fix.register == register]
    assert (fix.servo, fix.held) == (2, held)
    assert want is None or fix.want == want
    line = registers(on.rig.joints[1].product)[register]
    assert line.low <= fix.want <= line.high and line.eeprom and line.access == "rw"
    assert fix.message()["from"] == held and fix.message()["to"] == fix.want
    assert on.written() == []


@pytest.mark.parametrize(("name", "model"), [("lamp-sts3215", 1284), ("lamp-ax12", 18), ("lamp-xl430", 1020)])
def test_a_wrong_model_is_told(benches, name, model):
    on = benches[name]
    table = on.virtual.servos[0].table
    before, table["model_number"] = table["model_number"], model
    try:
        outcome = on.run(arm=False)
    finally:
        table["model_number"] = before
    product = on.rig.joints[0].product
    assert f"is a model {model}, the rig says {product.name} (model {product.model_number})" in outcome.reason


@pytest.mark.parametrize("name", ["lamp-sts3215", "lamp-ax12"])
@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("supply=8.5", "its supply is 8.5 V, at least"),
        ("dead=3", "joint a2 (servo 3): does not answer on virtual"),
        ("corrupt=1", "answers with corrupt packets only"),
        ("overload=1", "joint a0 (servo 1) reports a hardware error (overload)"),
        ("late=1:40", "ms late; set the adapter's latency timer to 1 ms"),
    ],
)
def test_a_rig_that_is_not_well_is_told(tmp_path, name, fault, sentence):
    outcome = Bench(tmp_path, fault, rig=RIGS[name]).run(arm=False)
    assert outcome.faulty and any(sentence in finding.text for finding in outcome.findings)


def test_the_line_time_of_a_period_is_what_the_manuals_count():
    # X: sync read 14 + 4 ids - 1 for three, 3 x 21 status; sync write 14 + 3 x 5; one read 14, its status 11 + 7
    bits = (14 + 3 + 3 * (11 + 10) + 14 + 3 * 5 + 14 + 11 + 7) * 10
    assert period_line_s(RIGS["lamp-xc330"]) == pytest.approx(bits / 1e6)
    # AX: three reads of 8, three statuses of 12; sync write 8 + 3 x 3; one read 8, its status 6 + 2
    bits = (3 * 8 + 3 * 12 + 8 + 3 * 3 + 8 + 6 + 2) * 10
    assert period_line_s(RIGS["lamp-ax12"]) == pytest.approx(bits / 1e6)
