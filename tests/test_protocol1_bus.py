"""Buses of protocol 1 framing: each defect of the vendors' SDKs, shown on the SDK itself, and the fence against it."""

import subprocess
import sys
from types import SimpleNamespace

import dynamixel_sdk
import pytest
import scripted_port
import scservo_sdk
from damage import damaged, damages
from dynamixel_sdk.robotis_def import COMM_NOT_AVAILABLE
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_port import ScriptedPort, replies

from deploy.buses.dynamixel1_bus import Dynamixel1Bus
from deploy.buses.feetech_bus import FeetechBus
from deploy.buses.open_bus import open_bus

scripted = scripted_port.scripted

BUSES = (Dynamixel1Bus, FeetechBus)
PACKET_HANDLERS = {
    Dynamixel1Bus: lambda: dynamixel_sdk.PacketHandler(1.0),
    FeetechBus: lambda: scservo_sdk.PacketHandler(0),
}
POSITION = {Dynamixel1Bus: 36, FeetechBus: 56}
SUCCESS, BUSY = 0, {Dynamixel1Bus: -1000, FeetechBus: -1}

both = pytest.mark.parametrize("kind", BUSES)


def framed(servo, *body):
    """Return a packet: both directions have one form, an instruction or an error and then parameters."""
    inside = bytes((servo, len(body) + 1, *body))
    return b"\xff\xff" + inside + bytes((~sum(inside) & 0xFF,))


def status(servo, data=b"", error=0):
    return framed(servo, error, *data)


# what is sent


@pytest.mark.parametrize(
    ("ask", "frame"),
    [
        (lambda bus: bus.ping(1), "FFFF 01 02 01 FB"),
        (lambda bus: bus.read(1, 43, 1), "FFFF 01 04 02 2B 01 CC"),
        (lambda bus: bus.sync_write(30, {0: b"\x10\x00\x50\x01", 1: b"\x20\x02\x60\x03"}),
         "FFFF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67"),
    ],
)  # fmt: skip
@both
def test_packets_are_the_manuals(scripted, kind, ask, frame):
    port = scripted(lambda _: [])
    ask(kind(port))
    assert port.sent_frames[0] == bytes.fromhex(frame)


def test_a_sync_read_is_one_question_to_sts_and_several_to_those_that_know_none(scripted):
    def answer(frame):
        asked = frame[7:-1] if frame[4] == 0x82 else frame[2:3]
        return [(1e-4, b"".join(status(servo, bytes((servo, 0))) for servo in asked))]

    port = scripted(answer)
    got = FeetechBus(port).sync_read([11, 12], 30, 2)
    assert port.sent_frames == [bytes.fromhex("FFFF FE 06 82 1E 02 0B 0C 42")]
    assert {servo: reply.data for servo, reply in got.items()} == {11: b"\x0b\x00", 12: b"\x0c\x00"}
    assert dynamixel_sdk.PacketHandler(1.0).syncReadTx(port, 30, 2, [11, 12], 2) == COMM_NOT_AVAILABLE
    for bus in (Dynamixel1Bus(scripted(answer)), FeetechBus(scripted(answer), 0.0, "scs")):
        got = bus.sync_read([11, 12], 30, 2)
        assert bus.port.sent_frames == [framed(11, 2, 30, 2), framed(12, 2, 30, 2)]
        assert [reply.data for reply in got.values()] == [b"\x0b\x00", b"\x0c\x00"]


# what is received


@both
def test_a_short_reply_is_no_crash_and_no_value(scripted, kind):
    refusal = status(1, error=0x08)
    with pytest.raises(IndexError):  # the SDK
        PACKET_HANDLERS[kind]().read2ByteTxRx(scripted(replies(refusal)), 1, POSITION[kind])
    reply = kind(scripted(replies(refusal))).read(1, POSITION[kind], 2)
    assert reply.data == b"" and reply.status in ("refused", "missing")
    if kind is Dynamixel1Bus:
        assert (reply.status, reply.refusal, reply.alert) == ("refused", "value out of range", False)


def test_what_ails_a_servo_is_told_beside_its_data(scripted):
    for kind, error in ((Dynamixel1Bus, 0x20), (Dynamixel1Bus, 0x04), (FeetechBus, 0x20), (FeetechBus, 0x01)):
        reply = kind(scripted(replies(status(1, b"\x01\x02", error)))).read(1, POSITION[kind], 2)
        assert (reply.status, reply.data, reply.error, reply.alert) == ("data", b"\x01\x02", error, True)


def test_a_silent_sts_servo_does_not_void_the_others_and_nothing_old_passes_for_new(scripted):
    here = (status(1, b"\x11\x11"), status(3, b"\x33\x33"))
    everyone = (here[0], status(2, b"\x22\x22"), here[1])
    port = scripted(replies(*everyone))
    group = scservo_sdk.GroupSyncRead(port, scservo_sdk.PacketHandler(0), 56, 2)
    for servo in (1, 2, 3):
        group.addParam(servo)
    assert group.txRxPacket() == SUCCESS
    port.answer = replies(status(1, b"\x44\x44"))  # servo 2 has died, so 3 waits for it in vain
    assert group.txRxPacket() != SUCCESS
    assert group.isAvailable(3, 56, 2) and group.getData(3, 56, 2) == 0x3333  # the SDK: stale, and "available"
    bus = FeetechBus(scripted(replies(*everyone)))
    bus.sync_read([1, 2, 3], 56, 2)
    bus.port.answer = replies(*here)
    got = bus.sync_read([1, 2, 3], 56, 2)
    assert [(reply.status, reply.data) for reply in got.values()] == [
        ("data", b"\x11\x11"), ("missing", b""), ("data", b"\x33\x33")
    ]  # fmt: skip
    bus.port.answer = replies(status(1, b"\x44\x44"))
    assert bus.sync_read([1, 2, 3], 56, 2)[3].data == b""


def test_the_byte_order_is_not_a_global_of_the_process(scripted):
    sts = scservo_sdk.PacketHandler(0)
    scservo_sdk.PacketHandler(1)  # somebody opens an SCS bus as well
    try:
        assert sts.read2ByteTxRx(scripted(replies(status(1, b"\x09\x03"))), 1, 3)[0] == 0x0903  # the SDK
        answer = lambda frame: [(1e-4, status(1, b"\x09\x03" if len(frame) == 8 else b""))]  # noqa: E731
        assert FeetechBus(scripted(answer)).ping(1)[1] == 777
        answer = lambda frame: [(1e-4, status(1, b"\x05\x04" if len(frame) == 8 else b""))]  # noqa: E731
        assert FeetechBus(scripted(answer), 0.0, "scs").ping(1)[1] == 1284
    finally:
        scservo_sdk.PacketHandler(0)


def test_a_late_reply_does_not_answer_the_next_question(scripted):
    def first_late():
        told = []

        def answer(frame):
            told.append(frame)
            data = bytes((len(told), *bytes(frame[6] - 1)))
            return [(0.0036 if len(told) == 1 else 0.0005, status(1, data))]

        return answer

    class UnflushedPort(ScriptedPort):
        def clearPort(self):  # noqa: N802 (what scservo_sdk's own port does: it flushes what is sent)
            self._serial.flush()

    port = UnflushedPort(first_late())
    try:
        sdk = scservo_sdk.PacketHandler(0)
        assert sdk.read2ByteTxRx(port, 1, 56)[1] != SUCCESS
        port.wait(0.01)  # the late reply has come before the next question is asked
        assert sdk.read2ByteTxRx(port, 1, 56)[0] == 1  # the SDK: the first answer, taken for the second
    finally:
        port.closePort()
    for kind in BUSES:
        port = scripted(first_late())
        bus = kind(port)
        assert bus.read(1, POSITION[kind], 2).status == "missing"
        port.time = 0.0033
        assert bus.read(1, POSITION[kind], 2).data == b"\x02\x00"


@both
def test_a_corrupt_length_does_not_swallow_the_next_reply(scripted, kind):
    broken = bytearray(status(1, b"\x01\x00"))
    broken[3] += 9
    wire = bytes(broken) + status(1, b"\x07\x00")
    assert PACKET_HANDLERS[kind]().read2ByteTxRx(scripted(replies(wire)), 1, POSITION[kind])[1] != SUCCESS
    assert kind(scripted(replies(wire))).read(1, POSITION[kind], 2).data == b"\x07\x00"


@both
def test_a_length_that_can_not_be_does_not_take_bytes_of_the_next_reply(scripted, kind):
    # servo 1 "answers" with length 1 and a checksum that fits, six bytes are read for five
    wire = bytes((0xFF, 0xFF, 1, 1, 0xFD)) + status(1, b"\x07\x00")
    assert kind(scripted(replies(wire))).read(1, POSITION[kind], 2).data == b"\x07\x00"


@both
def test_an_adapter_that_echoes_is_not_taken_for_a_servo(scripted, kind):
    def echo(frame):
        return [(1e-5, frame)]

    def echo_and_answer(frame):
        return [(1e-5, frame), (1e-4, status(1, b"\x07\x00" if frame[4] == 2 else b""))]

    value, result, _ = PACKET_HANDLERS[kind]().read2ByteTxRx(scripted(echo), 1, POSITION[kind])
    assert (value, result) == (POSITION[kind] + 0x200, SUCCESS)  # the SDK: its own question is a position
    assert kind(scripted(echo)).read(1, POSITION[kind], 2).status == "missing"
    assert kind(scripted(echo)).ping(1)[0].status == "missing"
    assert kind(scripted(echo_and_answer)).read(1, POSITION[kind], 2).data == b"\x07\x00"
    assert kind(scripted(echo_and_answer)).write(1, 30, b"\x01").status == "data"
    assert kind(scripted(echo_and_answer)).ping(1)[1] == 7


@both
def test_a_ping_whose_answer_equals_the_question_is_an_answer(scripted, kind):
    # a servo whose supply is out of range sets bit 0 of its error: the very bytes of a ping
    def low_voltage(frame):
        return [(1e-4, status(1, b"\x0c\x00" if frame[4] == 2 else b"", error=1))]

    reply, model = kind(scripted(low_voltage)).ping(1)
    assert (reply.status, reply.alert, model) == ("data", True, 12)


@both
def test_the_port_is_free_after_an_exception(scripted, kind):
    def cut(frame):
        raise OSError("unplugged")

    port = scripted(cut)
    with pytest.raises(OSError, match="unplugged"):
        PACKET_HANDLERS[kind]().read2ByteTxRx(port, 1, 56)
    assert PACKET_HANDLERS[kind]().read2ByteTxRx(port, 1, 56)[1] == BUSY[kind]  # the SDK's port stays taken
    port.answer = replies(status(1, b"\x01\x00"))
    assert kind(port).read(1, 56, 2).status == "data"


@both
def test_there_is_no_reboot(scripted, kind):
    port = scripted(lambda _: [])
    assert kind(port).reboot(1) is None and port.sent_frames == []


@pytest.fixture(scope="module")
def scripted_port_kept():
    port = ScriptedPort(lambda _: [])
    yield port
    port.closePort()


@given(damage=damages(45, 3), kind=st.sampled_from(BUSES))
@settings(max_examples=200)
def test_damage_raises_nothing_and_a_good_packet_afterwards_is_heard(scripted_port_kept, damage, kind):
    port = scripted_port_kept
    port.answer = replies(damaged(status(1, b"\xff\xff") + status(1, b"\x00\xff"), damage))
    reply = kind(port).read(1, POSITION[kind], 2)
    assert reply.status in ("data", "refused", "missing", "corrupt")
    port.answer = replies(status(1, b"\x07\x00"))
    bus = kind(port)
    assert bus.read(1, POSITION[kind], 2).data == b"\x07\x00"


# who speaks what


def test_a_rig_is_given_the_bus_of_its_protocol(scripted):
    def bus(protocol):
        rig = SimpleNamespace(bus=SimpleNamespace(protocol=protocol, return_delay_us=500))
        return open_bus(scripted(lambda _: []), rig)

    assert type(bus("dynamixel-1.0")) is Dynamixel1Bus
    assert type(bus("feetech-sts")) is FeetechBus and bus("feetech-sts").has_sync_read
    assert type(bus("feetech-scs")) is FeetechBus and not bus("feetech-scs").has_sync_read
    assert bus("feetech-scs").return_delay_s == 500e-6


def test_the_other_package_of_the_sdks_name_is_told_in_one_sentence(tmp_path):
    # ftservo-python-sdk 2.0 has no `packet_handler`, and its handler wants a port and a byte order
    fake = tmp_path / "scservo_sdk"
    fake.mkdir()
    (fake / "__init__.py").write_text("")
    (fake / "protocol_packet_handler.py").write_text(
        "class protocol_packet_handler:\n    def __init__(self, portHandler, protocol_end):\n        pass\n"
    )
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "import deploy.buses.feetech_bus as bus\nbus.packet_handler()"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "InputError: the package ftservo-python-sdk stands where feetech-servo-sdk should" in result.stderr
    assert "pip uninstall ftservo-python-sdk" in result.stderr
