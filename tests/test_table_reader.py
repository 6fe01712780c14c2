"""A servo's whole table is read in few questions, and register by register where a servo refuses more."""

import pytest

from controller import load_rig
from controller.registers import registers
from deploy.buses.dynamixel_bus import DynamixelBus
from deploy.buses.lockstep_port import LockstepPort
from deploy.buses.open_bus import open_bus
from deploy.buses.servo_bus import BusError, Reply
from deploy.buses.table_reader import read_table
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig

X330 = load_rig("lamp-xc330")


class Picky(DynamixelBus):
    """A bus whose servos refuse addresses at which they have no register, as the manual lets them."""

    table = registers(X330.joints[0].product)

    def read(self, servo, address, length):
        known = {line.address + byte for line in self.table.values() for byte in range(line.size)}
        if not known.issuperset(range(address, address + length)):
            return Reply(servo, "refused", b"", 7, self.port.now(), False, "no such address")
        return super().read(servo, address, length)


@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-xl430", "lamp-ax12", "lamp-sts3215"])
def test_every_register_is_read(name):
    rig = load_rig(name)
    with LockstepBench(VirtualRig(rig)) as bench:
        bus = open_bus(LockstepPort(bench, rig.bus.baud), rig)
        values = read_table(bus, 2, rig.joints[1].product)
        single = {line.name: bus.read_register(2, line) for line in registers(rig.joints[1].product).values()}
        bus.close()
    moving = {
        "realtime_tick",
        "present_position",
        "present_velocity",
        "present_current",
        "present_load",
        "present_speed",
    }
    assert values.keys() == single.keys()
    assert {name: values[name] for name in values.keys() - moving} == {
        name: single[name] for name in single.keys() - moving
    }


def test_a_servo_that_refuses_gaps_is_read_around_them():
    with LockstepBench(VirtualRig(X330)) as bench:
        bus = Picky(LockstepPort(bench, X330.bus.baud))
        values = read_table(bus, 1, X330.joints[0].product)
        bus.close()
    assert values.keys() == registers(X330.joints[0].product).keys()
    assert (values["id"], values["model_number"]) == (1, 1230)


def test_a_silent_servo_is_an_error():
    with LockstepBench(VirtualRig(X330, faults=[parse_fault("dead=1")])) as bench:
        bus = DynamixelBus(LockstepPort(bench, X330.bus.baud))
        with pytest.raises(BusError, match="its registers can not be read; check cables"):
            read_table(bus, 1, X330.joints[0].product)
        bus.close()
