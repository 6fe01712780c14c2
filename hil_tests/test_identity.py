"""Is it the rig that its file says? Nothing is written here."""

from __future__ import annotations

from controller import registers
from deploy.checks import check_servos


def test_every_servo_is_the_right_one(bench, report):
    for joint in bench.rig.joints:
        reply, model = bench.bus.ping(joint.id)
        assert reply.status == "data" and not reply.alert
        if bench.rig.bus.protocol != "dynamixel-2.0":  # a ping of protocol 1 tells no model
            model = bench.read(joint, joint.family.model_number)
        assert model == joint.product.model_number
        version = bench.read(joint, "firmware_version") if "firmware_version" in registers(joint.product) else None
        servo = {
            "joint": joint.name,
            "id": joint.id,
            "product": joint.product.name,
            "model": model,
            "firmware": version,
        }
        report.servos.append(servo)
    assert bench.values("id") == list(bench.ids)


def test_start_up_checks_find_nothing_wrong(bench):
    _, findings = check_servos(bench.bus, bench.rig)
    assert [finding.text for finding in findings if finding.level == "error"] == []


def test_eeprom_is_as_the_rig_says(bench):
    rig = bench.rig
    for joint in rig.joints:
        family = joint.family
        assert family.bauds[bench.read(joint, family.baud_rate)] == rig.bus.baud
        assert 2 * bench.read(joint, family.return_delay) == rig.bus.return_delay_us
        if family.operating_mode is not None:
            assert bench.read(joint, family.operating_mode) == family.modes[joint.mode]


def test_health_is_good(bench, measured):
    rig = bench.rig
    volts = [
        bench.read(joint, joint.family.voltage) * registers(joint.product)[joint.family.voltage].scale
        for joint in rig.joints
    ]
    warmth = bench.values("temperature")
    measured("supply", "V", f"warned of below {rig.safety.voltage_low_v:g}", least=min(volts), most=max(volts))
    limit = rig.safety.temperature_c_max
    measured("temperature", "degC", f"stops above {limit:g}", least=min(warmth), most=max(warmth))
    assert min(volts) >= rig.safety.voltage_low_v
    assert max(warmth) <= rig.safety.temperature_c_max
