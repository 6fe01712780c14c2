"""The vendors' own SDKs against the virtual AX-12A, STS3215 and SCS0009, unmodified, in the bench's own time."""

import pytest
import scservo_sdk
from dynamixel_sdk import COMM_NOT_AVAILABLE, COMM_RX_TIMEOUT, COMM_SUCCESS, GroupSyncWrite, PacketHandler

from controller.products import PRODUCTS
from tests.motor_bench import Bench

AX, STS, SCS = PRODUCTS["ax-12a"], PRODUCTS["sts3215"], PRODUCTS["scs0009"]
OK = (COMM_SUCCESS, 0)


class BenchPort:
    """Give an SDK's packet handler a port to servos on a bench: what is asked has been answered when it looks."""

    def __init__(self, bench):
        self.bench, self.unread, self.is_using = bench, bytearray(), False

    def clearPort(self):  # noqa: N802 (the SDK's name)
        self.unread.clear()

    def writePort(self, packet):  # noqa: N802 (the SDK's name)
        self.unread += b"".join(frame for _, frame in self.bench.frames(bytes(packet)))
        return len(packet)

    def readPort(self, length):  # noqa: N802 (the SDK's name)
        taken = self.unread[:length]
        del self.unread[:length]
        return taken

    def setPacketTimeout(self, length):  # noqa: N802 (the SDK's name)
        pass

    def isPacketTimeout(self):  # noqa: N802 (the SDK's name)
        return not self.unread


@pytest.fixture
def feetech():
    """Give the SDK a byte order, which is a global of its."""

    def handler(big_end):
        return scservo_sdk.PacketHandler(int(big_end))

    yield handler
    scservo_sdk.PacketHandler(0)


def test_robotis_sdk_drives_an_ax():
    sdk, port = PacketHandler(1.0), BenchPort(Bench((AX, {"id": 1}, 512.0), (AX, {"id": 2}, 512.0)))
    assert sdk.ping(port, 1) == (12, *OK)
    assert sdk.ping(port, 9)[1] == COMM_RX_TIMEOUT
    assert sdk.write1ByteTxRx(port, 1, 24, 1) == OK
    assert sdk.write2ByteTxRx(port, 1, 30, 600) == OK
    port.bench.wait(1.0)
    position, *result = sdk.read2ByteTxRx(port, 1, 36)
    assert (tuple(result), position) == (OK, pytest.approx(600, abs=3))
    result, error = sdk.write2ByteTxRx(port, 1, 30, 2000)
    assert (result, sdk.getRxPacketError(error)) == (COMM_SUCCESS, "[RxPacketError] Out of range error!")
    group = GroupSyncWrite(port, sdk, 30, 4)
    assert [group.addParam(i, [0, 2, 100, 0]) for i in (1, 2)] == [True, True]
    assert group.txPacket() == COMM_SUCCESS
    assert [sdk.read4ByteTxRx(port, i, 30)[0] for i in (1, 2)] == [512 | 100 << 16] * 2
    assert sdk.regWriteTxRx(port, 2, 30, 2, [44, 1]) == OK
    assert sdk.action(port, 254) == COMM_SUCCESS
    assert sdk.read2ByteTxRx(port, 2, 30)[0] == 300
    assert sdk.reboot(port, 1)[0] == COMM_NOT_AVAILABLE
    assert sdk.factoryReset(port, 2) == OK


def test_feetechs_sdk_drives_an_sts(feetech):
    sdk, port = feetech(False), BenchPort(Bench(*((STS, {"id": i}, 2048.0) for i in (1, 2, 3))))
    assert sdk.ping(port, 2) == (777, *OK)
    assert sdk.write2ByteTxRx(port, 1, 42, 2500) == OK
    assert sdk.regWriteTxRx(port, 2, 42, 2, [scservo_sdk.SCS_LOBYTE(1500), scservo_sdk.SCS_HIBYTE(1500)]) == OK
    assert sdk.action(port, 254) == COMM_SUCCESS
    port.bench.wait(1.5)
    group = scservo_sdk.GroupSyncRead(port, sdk, 56, 8)
    for servo in (1, 2, 3):
        group.addParam(servo)
    assert group.txRxPacket() == COMM_SUCCESS
    assert [group.getData(i, 56, 2) for i in (1, 2, 3)] == pytest.approx([2500, 1500, 2048], abs=12)
    assert [(group.getData(i, 62, 1), group.getData(i, 63, 1)) for i in (1, 2, 3)] == [(120, 25)] * 3
    back = scservo_sdk.GroupSyncWrite(port, sdk, 41, 7)
    for servo in (1, 2, 3):
        back.addParam(servo, [50, 0, 8, 0, 0, 0xE8, 3])
    assert back.txPacket() == COMM_SUCCESS
    port.bench.wait(2.0)
    assert [sdk.read2ByteTxRx(port, i, 56)[0] for i in (1, 2, 3)] == pytest.approx([2048] * 3, abs=12)


def test_feetechs_sdk_drives_an_scs(feetech):
    sdk, port = feetech(True), BenchPort(Bench((SCS, {"id": 1}, 512.0)))
    assert sdk.ping(port, 1) == (1284, *OK)
    assert sdk.write2ByteTxRx(port, 1, 42, 700) == OK
    port.bench.wait(1.0)
    position, *result = sdk.read2ByteTxRx(port, 1, 56)
    assert (tuple(result), position) == (OK, pytest.approx(700, abs=10))
    group = scservo_sdk.GroupSyncRead(port, sdk, 56, 2)
    group.addParam(1)
    assert group.txRxPacket() == scservo_sdk.COMM_RX_TIMEOUT


def test_the_sdk_changes_id_and_keeps_it_by_the_lock(feetech):
    sdk, port = feetech(False), BenchPort(Bench((STS, {"id": 1}, 2048.0)))
    for address, value in ((55, 0), (5, 8)):
        assert sdk.write1ByteTxRx(port, 1, address, value) == OK
    assert sdk.write1ByteTxRx(port, 8, 55, 1) == OK
    port.bench.servos[0].reboot(port.bench.now_ns)
    port.bench.wait(0.5)
    assert sdk.ping(port, 8) == (777, *OK)
