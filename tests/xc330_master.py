"""A master that asks virtual XC330 servos over their line."""

import dynamixel_master
from dynamixel_master import block

from controller.registers import registers
from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl

RIG = load_rig("lamp-xc330")
LINES = registers(RIG.joints[0].product)
BYTE_S = 10 / RIG.bus.baud


class Master(dynamixel_master.Master):
    """Ask a virtual XC330 rig."""

    def __init__(self, rig=RIG, **settings):
        super().__init__(rig, **settings)

    def sync_read(self, name, servos):
        line = LINES[name]
        answers = self.ask(dxl.BROADCAST, dxl.SYNC_READ, block(line.address, line.size) + bytes(servos))
        return {servo: int.from_bytes(data, "little", signed=line.signed) for servo, _, data in answers}

    def sync_write(self, name, values):
        line = LINES[name]
        data = b"".join(bytes([servo]) + value.to_bytes(line.size, "little") for servo, value in values.items())
        return self.ask(dxl.BROADCAST, dxl.SYNC_WRITE, block(line.address, line.size) + data)
