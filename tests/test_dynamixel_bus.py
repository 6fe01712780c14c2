"""The bus adapter: each defect of the vendor's SDK, shown on the SDK itself, and the fence that keeps it out."""

import pytest
import scripted_port
from damage import damaged, damages
from dynamixel_sdk import GroupSyncRead, PacketHandler
from dynamixel_sdk.port_handler import PortHandler
from dynamixel_sdk.robotis_def import COMM_PORT_BUSY, COMM_RX_TIMEOUT, COMM_SUCCESS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scripted_port import BAUD, ScriptedPort, replies

from controller import load_rig, registers
from controller.errors import InputError
from deploy.buses.dynamixel_bus import BusError, DynamixelBus, decode, encode
from deploy.buses.port import PortLostError, SerialPort
from deploy.buses.port_lock import PortLock
from deploy.connection import connect_virtual
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.faults import parse_fault
from deploy.virtual.pty_line import PtyLine
from deploy.virtual.rig import VirtualRig

RIG = load_rig("lamp-xc330")
TABLE = registers(RIG.joints[0].product)
POSITION = TABLE["present_position"]

scripted = scripted_port.scripted


def status(servo, data=b"", error=0):
    return dxl.encode_status(servo, error, data)


def position(count):
    return count.to_bytes(4, "little", signed=True)


# what is sent


@pytest.mark.parametrize(
    ("ask", "frame"),
    [
        (lambda bus: bus.ping(1), "FFFFFD00 01 0300 01 194E"),
        (lambda bus: bus.read(1, 132, 4), "FFFFFD00 01 0700 02 8400 0400 1D15"),
        (lambda bus: bus.write(1, 116, (512).to_bytes(4, "little")), "FFFFFD00 01 0900 03 7400 00020000 CA89"),
        (lambda bus: bus.reboot(1), "FFFFFD00 01 0300 08 2F4E"),
        (lambda bus: bus.sync_read([1, 2], 132, 4), "FFFFFD00 FE 0900 82 8400 0400 01 02 CEFA"),
        (
            lambda bus: bus.sync_write(116, {1: (150).to_bytes(4, "little"), 2: (170).to_bytes(4, "little")}),
            "FFFFFD00 FE 1100 83 7400 0400 01 96000000 02 AA000000 8287",
        ),
    ],
)
def test_packets_are_the_manuals(scripted, ask, frame):
    port = scripted(lambda _: [])
    ask(DynamixelBus(port))
    assert port.sent_frames[0] == bytes.fromhex(frame)


def test_what_is_sent_is_stuffed(scripted):
    data = bytes.fromhex("FFFFFD01")
    bare = scripted(lambda _: [])
    PacketHandler(2.0).writeTxOnly(bare, 1, 116, 4, list(data))
    assert bytes.fromhex("FFFFFDFD") not in bare.sent_frames[0]  # the SDK's packet holds a header in its middle
    fenced = scripted(lambda _: [])
    DynamixelBus(fenced).write(1, 116, data)
    assert fenced.sent_frames[0] == dxl.encode(1, dxl.WRITE, bytes((116, 0)) + data)


# what is received


def test_un_stuffing_keeps_every_byte(scripted):
    data = bytes.fromhex("FFFFFDFFFDFD0000")
    got, result, _ = PacketHandler(2.0).readTxRx(scripted(replies(status(1, data))), 1, 208, len(data))
    assert result == COMM_SUCCESS and bytes(got) != data  # the SDK loses a byte
    assert DynamixelBus(scripted(replies(status(1, data)))).read(1, 208, len(data)).data == data


@given(data=st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x01]), min_size=1, max_size=24).map(bytes))
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_data_arrive_as_they_were_sent(scripted_port, data):
    scripted_port.answer = replies(status(1, data))
    reply = DynamixelBus(scripted_port).read(1, 208, len(data))
    assert (reply.status, reply.data) == ("data", data)
    scripted_port.answer = replies(status(1))
    DynamixelBus(scripted_port).write(1, 208, data)
    assert scripted_port.sent_frames[-1] == dxl.encode(1, dxl.WRITE, bytes((208, 0)) + data)


@pytest.fixture(scope="module")
def scripted_port():
    port = ScriptedPort(lambda _: [])
    yield port
    port.closePort()


def test_an_error_reply_is_not_taken_for_data(scripted):
    refusal = status(1, error=dxl.ACCESS_ERROR)
    value, result, _ = PacketHandler(2.0).read2ByteTxRx(scripted(replies(refusal)), 1, 132)
    assert result == COMM_SUCCESS and value == int.from_bytes(refusal[-2:], "little")  # the SDK returns the CRC
    reply = DynamixelBus(scripted(replies(refusal))).read(1, 132, 2)
    assert (reply.status, reply.data) == ("refused", b"")
    assert "read-only" in reply.refusal


def test_a_silent_servo_does_not_void_the_others(scripted):
    here = (status(1, position(1111)), status(3, position(3333)))
    group = GroupSyncRead(scripted(replies(*here)), PacketHandler(2.0), 132, 4)
    for servo in (1, 2, 3):
        group.addParam(servo)
    assert group.txRxPacket() != COMM_SUCCESS
    assert [group.isAvailable(servo, 132, 4) for servo in (1, 2, 3)] == [False] * 3
    assert [group.getData(servo, 132, 4) for servo in (1, 2, 3)] == [0] * 3  # a legal position
    got = DynamixelBus(scripted(replies(*here))).sync_read([1, 2, 3], 132, 4)
    assert [got[servo].status for servo in (1, 2, 3)] == ["data", "missing", "data"]
    assert [decode(POSITION, got[servo].data) for servo in (1, 3)] == [1111, 3333]
    assert got[2].data == b""


def test_alerts_are_data(scripted):
    got = DynamixelBus(scripted(replies(status(1, position(5), error=dxl.ALERT), status(2, position(6))))).sync_read(
        [1, 2], 132, 4
    )
    assert [reply.status for reply in got.values()] == ["data", "data"]
    assert [got[servo].alert for servo in (1, 2)] == [True, False]


def test_a_corrupt_length_does_not_swallow_the_next_reply(scripted):
    broken = bytearray(status(1, position(1)))
    broken[5] += 15  # says that the second servo's packet is part of it
    frames = (bytes(broken), status(2, position(2)))
    sdk, port = PacketHandler(2.0), scripted(replies(*frames))
    sdk.syncReadTx(port, 132, 4, [1, 2], 2, False)
    assert [sdk.readRx(port, servo, 4)[1] for servo in (1, 2)] == [-3002, COMM_RX_TIMEOUT]
    got = DynamixelBus(scripted(replies(*frames))).sync_read([1, 2], 132, 4)
    assert (got[1].status, got[2].data) == ("corrupt", position(2))


@given(damage=damages(45, 4))
@settings(max_examples=200)
def test_damage_never_makes_a_wrong_value(scripted_port, damage):
    counts = {1: 0x00FFFDFF, 2: -7, 3: 2048}
    wire = damaged(b"".join(status(servo, position(count)) for servo, count in counts.items()), damage)
    scripted_port.answer = lambda frame: [(1e-4, wire)] if frame[7] == dxl.SYNC_READ else []
    got = DynamixelBus(scripted_port).sync_read(list(counts), 132, 4)
    for servo, reply in got.items():
        assert reply.status in ("data", "missing", "corrupt", "refused")
        assert reply.data in (b"", position(counts[servo]))
    if not damage:
        assert all(reply.status == "data" for reply in got.values())


# the port


def test_the_port_is_free_after_an_exception(scripted):
    def cut(frame):
        raise OSError("unplugged")

    port = scripted(cut)
    with pytest.raises(OSError, match="unplugged"):
        PacketHandler(2.0).readTxRx(port, 1, 132, 4)
    assert PacketHandler(2.0).readTxRx(port, 1, 132, 4)[1] == COMM_PORT_BUSY  # the SDK's port stays taken
    bus = DynamixelBus(port)
    with pytest.raises(OSError, match="unplugged"):
        bus.read(1, 132, 4)
    port.answer = replies(status(1, position(9)))
    assert bus.read(1, 132, 4).data == position(9)


def test_a_late_reply_does_not_answer_the_next_question(scripted):
    def first_late():
        told = []

        def answer(frame):
            told.append(frame)
            data = position(len(told)) + bytes(frame[10] - 4)
            return [(0.0036 if len(told) == 1 else 0.0005, status(1, data))]

        return answer

    # the first question is given up at 2 ms and more; its answer comes after the second has been asked
    sdk, port = PacketHandler(2.0), scripted(first_late())
    assert sdk.readTxRx(port, 1, 132, 4)[1] == COMM_RX_TIMEOUT
    port.time = 0.0033
    assert bytes(sdk.readTxRx(port, 1, 132, 4)[0]) == position(1)  # the SDK: a stale value, taken for a fresh one
    port = scripted(first_late())
    bus = DynamixelBus(port)
    assert bus.read(1, 132, 4).status == "missing"
    port.time = 0.0033
    assert bus.read(1, 132, 4).data == position(2)
    assert [frame[10] for frame in port.sent_frames] == [4, 5]  # the second asks for one byte more
    port.time = 1.0
    bus.read(1, 132, 4)
    assert port.sent_frames[-1][10] == 4  # nothing can be late any more


@pytest.mark.parametrize(
    ("wanted", "asked"),
    [
        ((4, 3, 3, 3), (4, 3, 5, 6)),
        ((4, 3, 3, 11), (4, 3, 5, 14)),  # lengths that differ by 8 count as one
        ((1,) * 10, (1, 2, 3, 4, 5, 6, 7, 8, 1, 2)),  # where every length may be late, the one that was lost first
    ],
)
def test_no_question_asks_for_as_many_bytes_as_an_answer_that_is_still_missing(scripted, wanted, asked):
    port = scripted(lambda _: [])
    bus = DynamixelBus(port)
    assert {bus.read(1 + number % 2, 132, length).status for number, length in enumerate(wanted)} == {"missing"}
    assert tuple(frame[10] for frame in port.sent_frames) == asked


def test_what_can_not_be_read_one_byte_further_is_read_as_it_is(scripted):
    def answer(frame):
        if len(port.sent_frames) == 1:
            return []
        return [(1e-4, status(1, b"\x07") if frame[10] == 1 else status(1, error=dxl.ACCESS_ERROR))]

    port = scripted(answer)
    bus = DynamixelBus(port)
    assert bus.read(1, 146, 1).status == "missing"
    assert bus.read(1, 146, 1).data == b"\x07"
    assert [frame[10] for frame in port.sent_frames] == [1, 2, 1]


def test_a_reply_that_waits_is_taken_however_late_the_process_wakes(scripted):
    port = scripted(lambda _: [])
    port.expect(15, 1, 0.0)
    port.line.write_through(status(1, position(7)))
    port.time += 1.0  # descheduled
    assert not port.isPacketTimeout()
    assert port.readPort(15) == status(1, position(7))
    assert port.isPacketTimeout()


def test_deadlines_do_not_follow_the_wall_clock(monkeypatch):
    with PtyLine() as line:
        port, plain = SerialPort(line.path, BAUD), PortHandler(line.path)
        try:
            port.latency_s = 3600.0
            port.expect(11, 1, 0.0)
            plain.setPacketTimeoutMillis(1.0e6)
            monkeypatch.setattr("time.time", lambda: 4.0e9)
            assert plain.isPacketTimeout()  # the SDK's own port gives up when the clock is set
            assert not port.isPacketTimeout()
        finally:
            port.closePort()


def test_waiting_for_a_byte_costs_no_processor_time():
    import time

    with PtyLine() as line:
        port = SerialPort(line.path, BAUD)
        try:
            port.latency_s = 0.3
            before = time.process_time()
            assert DynamixelBus(port).read(1, 132, 4).status == "missing"
            assert time.process_time() - before < 0.15  # a busy wait burns the whole 0.3 s
        finally:
            port.closePort()


def test_a_port_is_locked_while_in_use():
    with PtyLine() as line:
        port = SerialPort(line.path, BAUD)
        with pytest.raises(InputError, match="in use by another program"):
            SerialPort(line.path, BAUD)
        port.closePort()
        SerialPort(line.path, BAUD).closePort()


def test_a_socket_is_locked_by_a_file_of_this_user_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with PortLock("socket://localhost:4000"):
        with pytest.raises(InputError, match="in use by another program"):
            PortLock("socket://localhost:4000")
        (folder,) = tmp_path.iterdir()
        assert folder.stat().st_mode & 0o077 == 0 and len(list(folder.iterdir())) == 1
    PortLock("socket://localhost:4000").close()


def test_a_port_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="cannot be opened"):
        SerialPort(str(tmp_path / "ttyUSB9"), BAUD)
    (tmp_path / "file").write_text("no port")
    with pytest.raises(InputError, match="cannot be opened as a serial port"):
        SerialPort(str(tmp_path / "file"), BAUD)


def test_an_unplugged_port_is_one_sentence():
    line = PtyLine()
    port = SerialPort(line.path, BAUD)
    line.close()
    with pytest.raises(PortLostError, match="the port is gone"):
        DynamixelBus(port).read(1, 132, 4)
    port.closePort()


# on the virtual rig


@pytest.fixture
def bench():
    """Return a function that connects to a virtual rig with faults."""
    from contextlib import ExitStack

    with ExitStack() as stack:

        def connect(*faults):
            virtual = VirtualRig(RIG, faults=[parse_fault(fault) for fault in faults])
            return stack.enter_context(connect_virtual(virtual, lambda: None)), virtual

        yield connect


@pytest.mark.parametrize("silent", [1, 2, 3])
@pytest.mark.parametrize("kind", ["dead", "mute"])
def test_a_silent_servo_costs_little_and_the_others_keep_their_data(bench, silent, kind):
    link, _ = bench(f"{kind}={silent}")
    for _ in range(3):
        before = link.clock.now()
        got = link.bus.sync_read([1, 2, 3], 126, 10)
        taken = link.clock.now() - before
        assert {servo: reply.status for servo, reply in got.items()} == {
            servo: "missing" if servo == silent else "data" for servo in (1, 2, 3)
        }
    assert taken < 0.003  # once known, it is asked last: the SDK's own wait is 34.7 ms


def test_a_servo_that_comes_back_is_read_again(bench):
    link, _ = bench("dead=1@0-0.1")
    assert link.bus.sync_read([1, 2, 3], 126, 10)[1].status == "missing"
    link.clock.sleep_until(0.5)
    assert [reply.status for reply in link.bus.sync_read([1, 2, 3], 126, 10).values()] == ["data"] * 3


def test_registers_are_written_and_read_back_by_name(bench):
    link, virtual = bench("drop=0.05", "corrupt=0.05")
    for value in (-885, -1, 0, 885):
        link.bus.write_register(2, TABLE["goal_pwm"], value)
        assert virtual.servos[1].table["goal_pwm"] == value
        assert link.bus.read_register(2, TABLE["goal_pwm"]) == value


def test_what_a_servo_refuses_is_told_in_one_sentence(bench):
    link, _ = bench()
    with pytest.raises(BusError, match=r"servo 2 on virtual lamp-xc330: writing 1 to model_number, it refused"):
        link.bus.write_register(2, TABLE["model_number"], 1)
    with pytest.raises(BusError, match=r"servo 9 .* did not answer; check its power"):
        link.bus.read_register(9, TABLE["model_number"])


def test_every_register_encodes_and_decodes():
    for register in TABLE.values():
        for value in {register.low, 0, 1, register.high}:
            assert decode(register, encode(register, value)) == value or value < register.low
