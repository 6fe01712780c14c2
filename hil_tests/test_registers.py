"""Do the registers keep their manual's rules? RAM only, and what is written is put back."""

from __future__ import annotations

import pytest

from controller import registers

ACCESS_ERROR = 7
REFUSALS_OF_LIMIT = (4, 6)  # the X series' manual names both for a goal beyond the limits


def test_every_register_can_be_read_within_its_range(bench):
    for joint in bench.rig.joints:
        for register in registers(joint.product).values():
            if register.name.startswith("indirect"):
                continue
            value = bench.bus.read_register(joint.id, register)
            if register.access == "rw" and register.name != joint.family.watchdog:
                assert register.low <= value <= register.high, register.name


def test_a_gain_is_written_and_read_back(bench):
    for joint in bench.rig.joints:
        table = registers(joint.product)
        name = next((name for name in joint.gains if not table[name].eeprom), None)
        if name is None:
            pytest.skip(f"{joint.product.name}: its gains are in EEPROM, which is not worn for a test")
        gain = table[name]
        before = bench.bus.read_register(joint.id, gain)
        for value in (gain.low, gain.low + 1, gain.high, before):
            bench.bus.write_register(joint.id, gain, value)
            assert bench.bus.read_register(joint.id, gain) == value


def test_a_read_only_register_keeps_its_value(bench):
    for joint in bench.rig.joints:
        model = joint.family.model_number
        before = bench.read(joint, model)
        reply = bench.write(joint, model, 0)
        if bench.rig.bus.protocol == "dynamixel-2.0":
            assert (reply.status, reply.error & 0x7F) == ("refused", ACCESS_ERROR)
        assert bench.read(joint, model) == before


def test_eeprom_is_locked_while_torque_is_on(bench, armed):
    if bench.rig.bus.protocol != "dynamixel-2.0":
        pytest.skip("only Dynamixel 2.0 promises it")
    for joint in bench.rig.joints:
        before = bench.read(joint, joint.family.return_delay)
        reply = bench.write(joint, joint.family.return_delay, before)
        assert (reply.status, reply.error & 0x7F) == ("refused", ACCESS_ERROR)


@pytest.mark.parametrize("beyond", ["lowest", "highest"])
def test_a_goal_beyond_the_limits_is_refused(bench, armed, beyond):
    if bench.family.protocol == "feetech":
        pytest.skip("Feetech's servos take such a goal and stop at their limit")
    for joint, seeded in zip(bench.rig.joints, armed, strict=True):
        low, high = (bench.read(joint, name) for name in joint.family.position_limits)
        if beyond == "lowest" and low == 0 and not bench.register(joint, joint.family.goal_position).signed:
            pytest.skip("no count is below 0")
        reply = bench.write(joint, joint.family.goal_position, low - 1 if beyond == "lowest" else high + 1)
        if bench.family.protocol == "dynamixel-1.0":
            assert reply.status == "refused"
        else:
            assert reply.status == "refused" and reply.error & 0x7F in REFUSALS_OF_LIMIT
        assert bench.read(joint, joint.family.goal_position) == seeded


def test_the_torque_ceiling_can_be_lowered(bench, armed):
    for joint in bench.rig.joints:
        name = joint.family.torque_ceiling
        if name is None:
            pytest.skip(f"{joint.product.name} has no torque ceiling in RAM")
        before = bench.read(joint, name)
        bench.bus.write_register(joint.id, bench.register(joint, name), before // 2)
        bench.bus.write_register(joint.id, bench.register(joint, name), before)
