"""Mutated bytes into every parser: nothing raises, and what is good is understood afterwards.

`--fuzz-seconds 600` shares ten minutes among the parsers; without it each gets a fixed number of mutations.
"""

import json
import random
import time

import pytest
from lamp_controllers import SWAY
from manual import scs_text

from controller.controller_file import load_controller, parse_controller
from controller.errors import InputError, RunError
from controller.registers import registers
from controller.rig_file import load_rig, parse_rig
from deploy.buses.sensor_reader import SensorReader, checksum
from deploy.commissioning.lerobot import read_calibration
from deploy.connection import connect_virtual
from deploy.logs.log import read_log
from deploy.virtual import dynamixel2, protocol1
from deploy.virtual.control_channel import answer_request
from deploy.virtual.eeprom_file import load_eeprom
from deploy.virtual.faults import parse_fault, read_faults
from deploy.virtual.rig import VirtualRig
from deploy.virtual.twin import load_twin

ROUNDS = 50
RIG = load_rig("lamp-xc330")
BURST = 4  # mutated pieces between two good ones
QUIET_S = 0.2  # a broken packet is forgotten by then


def mutate(rng, seeds):
    """Return one of the seeds with bytes flipped, cut, doubled, inserted, or two of them spliced."""
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(data) + 1)
        match rng.randrange(7):
            case 0 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case 1 if data:
                data[at % len(data)] = rng.choice((0, 0xFF, 0xFD, 0xFE, 0x7F, rng.randrange(256)))
            case 2:
                del data[at : at + rng.choice((1, 2, 8))]
            case 3:
                data[at:at] = rng.randbytes(rng.choice((1, 2, 8)))
            case 4:
                data[at:at] = data[at : at + 8]
            case 5:
                other = rng.choice(seeds)
                data[at:] = other[rng.randrange(len(other) + 1) :]
            case _:
                del data[at:]
    return bytes(data)


@pytest.fixture
def rounds(request):
    """Yield random generators, one a round: a fixed number of them, or as many as the time allows."""
    seconds = request.config.getoption("--fuzz-seconds") / request.config.stash[TARGETS]
    began = time.monotonic()

    def numbers():
        number = 0
        while number < ROUNDS or time.monotonic() - began < seconds:
            yield number
            number += 1

    return (random.Random(number) for number in numbers())


TARGETS = pytest.StashKey[int]()


@pytest.fixture(autouse=True, scope="session")
def _count_targets(request):
    request.config.stash[TARGETS] = max(1, sum("rounds" in item.fixturenames for item in request.session.items))


# packets

X_FRAMES = [
    dynamixel2.encode(1, dynamixel2.PING),
    dynamixel2.encode(0xFE, dynamixel2.PING),
    dynamixel2.encode(2, dynamixel2.READ, bytes((132, 0, 4, 0))),
    dynamixel2.encode(3, dynamixel2.WRITE, bytes((116, 0, 0, 8, 0, 0))),
    dynamixel2.encode(0xFE, dynamixel2.SYNC_READ, bytes((126, 0, 10, 0, 1, 2, 3))),
    dynamixel2.encode(0xFE, dynamixel2.SYNC_WRITE, bytes((116, 0, 4, 0, 1, 0, 8, 0, 0, 2, 0, 8, 0, 0))),
    dynamixel2.encode(1, 4, bytes((65, 0, 1))),
    dynamixel2.encode(0xFE, 0x92, bytes((1, 144, 0, 2, 0, 2, 146, 0, 1, 0))),
    dynamixel2.encode(0xFE, 0x93, bytes((1, 65, 0, 1, 0, 1, 2, 84, 0, 2, 0, 9, 9))),
    dynamixel2.encode(0xFE, 0x8A, bytes((132, 0, 4, 0, 1, 2, 3))),
    dynamixel2.encode(1, dynamixel2.WRITE, bytes((120, 0, 255, 255, 253, 255, 255, 253))),
    dynamixel2.encode_status(1, 0, bytes((1, 2, 3, 4))),
]
FIRST_FRAMES = [
    protocol1.encode(1, protocol1.PING),
    protocol1.encode(0xFE, protocol1.PING),
    protocol1.encode(2, protocol1.READ, bytes((36, 2))),
    protocol1.encode(3, protocol1.WRITE, bytes((30, 0, 2))),
    protocol1.encode(1, protocol1.REG_WRITE, bytes((30, 0, 2))),
    protocol1.encode(0xFE, protocol1.ACTION),
    protocol1.encode(0xFE, protocol1.SYNC_READ, bytes((56, 2, 1, 2, 3))),
    protocol1.encode(0xFE, protocol1.SYNC_WRITE, bytes((30, 2, 1, 0, 2, 2, 0, 2))),
    protocol1.encode_status(1, 0, bytes((1, 2, 3, 4))),
]


@pytest.mark.parametrize(("codec", "frames"), [(dynamixel2, X_FRAMES), (protocol1, FIRST_FRAMES)])
def test_packet_parsers(rounds, codec, frames):
    parser = codec.PacketParser()
    for rng in rounds:
        for _ in range(BURST):
            data = mutate(rng, frames)
            cut = rng.randrange(len(data) + 1)
            for piece in (data[:cut], data[cut:]):
                for packet in parser.feed(piece):
                    assert packet.end > 0
        # what is left of a broken packet is forgotten after a pause
        parser.abandon()
        good = rng.choice(frames)
        found = parser.feed(good)
        assert codec.encode(found[-1].id, found[-1].instruction, found[-1].parameters) == good
        assert parser.waiting < len(good)


def answered(rig, frame):
    """Send a frame after a pause; return what comes back."""
    t = rig.transmit(frame, rig.now + QUIET_S)
    replies = b""
    while (event := rig.next_event()) is not None:
        t = event
        replies += b"".join(reply for _, reply in rig.replies_until(t))
    return replies


LINES = {
    "lamp-xc330": (dynamixel2, X_FRAMES),
    "lamp-ax12": (protocol1, FIRST_FRAMES),
    "lamp-sts3215": (protocol1, FIRST_FRAMES),
}


@pytest.mark.parametrize("name", LINES)
def test_lines_of_servos(rounds, name):
    codec, frames = LINES[name]
    rig = VirtualRig(load_rig(name))
    for rng in rounds:
        for _ in range(BURST):
            answered_to = rig.transmit(mutate(rng, frames), rig.now + rng.choice((0.0, 1e-4, QUIET_S)))
            rig.replies_until(answered_to + rng.choice((0.0, 1e-3)))
        while (event := rig.next_event()) is not None:
            rig.replies_until(event)
        if codec is dynamixel2:
            found = codec.PacketParser().feed(answered(rig, codec.encode(codec.BROADCAST, codec.PING)))
            assert [packet.id for packet in found] == [1, 2, 3]
            continue
        # with one byte for a checksum, a mutated frame is now and then a good one that changes an id or a rate
        replies = [answered(rig, codec.encode(servo, codec.PING)) for servo in (1, 2, 3)]
        if not all(replies):
            rig = VirtualRig(load_rig(name))
            continue
        assert [codec.PacketParser().feed(reply)[-1].id for reply in replies] == [1, 2, 3]


def sealed(rng, frames):
    """Return a frame with mutated content and the right CRC, which reaches the servo behind the parser."""
    codec, frame = frames
    packet = codec.PacketParser().feed(frame)[0]
    instruction = rng.choice((packet.instruction, rng.randrange(256)))
    return codec.encode(
        rng.choice((packet.id, rng.randrange(0xFD))), instruction, mutate(rng, [packet.parameters])[:200]
    )


@pytest.mark.parametrize("name", LINES)
def test_servos_that_get_well_formed_nonsense(rounds, name):
    codec, frames = LINES[name]
    about = load_rig(name)
    for number, rng in enumerate(rounds):
        if number % 40 == 0:
            rig = VirtualRig(about)  # they may have been given new ids and rates
        for _ in range(BURST):
            answered(rig, sealed(rng, (codec, rng.choice(frames))))
        rig.advance(rig.now + QUIET_S)


class Babbling(VirtualRig):
    """A rig whose replies reach the master mutated."""

    rng = None

    def replies_until(self, t):
        replies = super().replies_until(t)
        if self.rng is None:
            return replies
        return [(end, mutate(self.rng, [reply])) for end, reply in replies]


@pytest.mark.parametrize("name", [*LINES, "scs"])
def test_the_hosts_bus_that_hears_nonsense(rounds, name):
    about = parse_rig(scs_text(), load_rig("lamp-xl330").path) if name == "scs" else load_rig(name)
    servos = [joint.id for joint in about.joints]
    joint = about.joints[0]
    table = registers(joint.product)
    first, last, gain = (table[key] for key in (*joint.family.state, "torque_enable"))
    block = (first.address, last.address + last.size - first.address)
    rig = Babbling(about)
    with connect_virtual(rig, lambda: None) as link:
        for rng in rounds:
            rig.rng = rng
            for _ in range(2):
                said = link.bus.sync_read(servos, *block)
                assert list(said) == servos
                single = link.bus.read(2, first.address, first.size)
                for reply in (*said.values(), single, link.bus.write(1, gain.address, b"\x00"), link.bus.ping(3)[0]):
                    assert reply.status in ("data", "refused", "missing", "corrupt")
                assert all(len(reply.data) == block[1] for reply in said.values() if reply.status == "data")
                assert single.status != "data" or len(single.data) == first.size
            rig.rng = None
            link.clock.sleep_until(link.clock.now() + 2 * QUIET_S)
            link.bus.sync_read(servos, *block)  # what came late is not the next answer
            assert {reply.status for reply in link.bus.sync_read(servos, *block).values()} == {"data"}


# sensor lines


def sensor_line(letter, seq, t_us, *raw):
    body = letter + b"".join(b",%d" % number for number in (seq, t_us, *raw))
    return b"$%s*%02X\r\n" % (body, checksum(body))


def test_sensor_lines(rounds):
    letters = {
        sensor.message: max(s.field for s in RIG.sensors if s.message == sensor.message) for sensor in RIG.sensors
    }
    seeds = [sensor_line(letter.encode(), 7, 123456, *range(count + 1)) for letter, count in letters.items()]
    seeds.append(b"$E*45\r\n")
    letter = RIG.sensors[0].message
    for rng in rounds:
        reader = SensorReader(RIG.sensors)
        for number in range(BURST):
            reader.feed(mutate(rng, seeds), 0.01 * number)
        raw = [rng.randrange(-1000, 1000) for _ in range(letters[letter] + 1)]
        reader.feed(b"\r\n" + sensor_line(letter.encode(), 2**31, 10**9, *raw), 1.0)
        assert reader.raw(0) == raw[RIG.sensors[0].field]


# files and command lines


def survives(rounds, seeds, read):
    """Read mutated files: whatever is wrong with them is one sentence of ours."""
    for rng in rounds:
        try:
            read(mutate(rng, seeds))
        except (InputError, RunError) as error:
            assert str(error) and "\n" not in str(error)


def file_reader(tmp_path, name, load):
    def read(data):
        path = tmp_path / name
        path.write_bytes(data)
        load(path)

    return read


def test_rig_files(rounds, tmp_path):
    (tmp_path / "body").mkdir()
    path = RIG.path
    copy = tmp_path / path.name
    for part in path.parent.iterdir():
        if part.is_file():
            (tmp_path / part.name).write_bytes(part.read_bytes())
    survives(rounds, [path.read_bytes()], file_reader(tmp_path, copy.name, load_rig))
    assert parse_rig(RIG.text, path) == RIG


def test_controller_files(rounds, tmp_path, figure_7_text):
    text = figure_7_text.encode()
    survives(rounds, [text], file_reader(tmp_path, "any.controller.toml", load_controller))
    assert parse_controller(figure_7_text, "here").name == "figure-7"


def test_twin_files(rounds, tmp_path):
    twin = b'format = 1\n[twin]\nname = "heavy"\nmass_scale = 1.5\nsupply_v = 4.8\ntimestep_s = 0.0005\n'
    survives(rounds, [twin], file_reader(tmp_path, "any.toml", load_twin))


def test_eeprom_files(rounds, tmp_path):
    servos = {joint.name: {"id": joint.id, "baud_rate": 3, "pwm_limit": 885} for joint in RIG.joints}
    good = json.dumps({"format": 1, "servos": servos, "backups": {"a0": {"pwm_limit": 885, "profile_velocity": 3}}})
    good = good.encode()
    read = file_reader(tmp_path, "eeprom.json", lambda path: load_eeprom(path, RIG))
    read(good)
    survives(rounds, [good], read)


def test_fault_specifications(rounds):
    seeds = [b"drop=0.01", b"dead=2@3.0-4.5", b"supply=4.2@1", b"sensor-dead=P", b"estop@3", b"overload=1@0-1e3"]
    survives(rounds, seeds, lambda data: parse_fault(data.decode("utf-8", "replace").replace("\n", " ")))


def test_fault_files(rounds, tmp_path):
    path = tmp_path / "faults.toml"

    def read(data):
        path.write_bytes(data)
        read_faults([str(path)])

    good = b'format = 1\nfaults = ["drop=0.01", "dead=2@3"]\n'
    read(good)
    survives(rounds, [good], read)


def test_lerobot_calibrations(rounds, tmp_path):
    motor = {"id": 1, "drive_mode": 0, "homing_offset": -1465, "range_min": 901, "range_max": 3195}
    good = json.dumps({"a0": motor, "a1": motor | {"id": 2}}, indent=4).encode()
    read = file_reader(tmp_path, "arm.json", read_calibration)
    read(good)
    survives(rounds, [good], read)


def test_control_requests(rounds):
    rig = VirtualRig(RIG)
    seeds = [b'{"faults": ["drop=0.5", "dead=2@1-2"]}', b'{"state": null}', b'{"time": null, "faults": []}']
    for rng in rounds:
        for _ in range(BURST):
            answer = json.loads(answer_request(rig, mutate(rng, seeds)))
            assert "error" in answer or "time" in answer
        assert json.loads(answer_request(rig, b'{"faults": []}'))["faults"] == []


def test_logs(rounds, tmp_path, short_log):
    good = short_log.read_bytes()
    assert read_log(short_log).complete
    survives(rounds, [good], file_reader(tmp_path, "any.mcap", read_log))


@pytest.fixture(scope="module")
def short_log(tmp_path_factory):
    """Return a log of a tenth of a second in lock step."""
    from servolve.cli import main

    folder = tmp_path_factory.mktemp("log")
    (folder / "sway.controller.toml").write_text(SWAY)
    log = folder / "run.mcap"
    arguments = ["deploy", f"{folder}/sway.controller.toml", "--rig", RIG.name, "--port", "virtual", "--log", f"{log}"]
    assert main([*arguments, "--seconds", "0.1"]) == 0
    return log
