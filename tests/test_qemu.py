"""Boards under QEMU: boot, the real receive interrupt, what happens when all is lost, and the same bytes every time.

QEMU has no independent watchdog for the STM32F405, so there only the tick's is tried; the MPS2's is.
"""

import hashlib
import os
import random
import subprocess
import time
from itertools import pairwise
from pathlib import Path
from select import select

import pytest
from firmware_runs import XC330, image

from controller.errors import InputError, RunError
from deploy.firmware import qemu
from deploy.firmware.bench import FirmwareBench
from deploy.firmware.console_decoder import ConsoleDecoder
from deploy.firmware.elf import read_symbols
from deploy.firmware.gdb_stub import LR, PC
from deploy.firmware.machine import Given
from deploy.firmware.qemu import BOARDS, Qemu
from deploy.firmware.records import Hello
from deploy.firmware.run_log import shape_of
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.rig import VirtualRig
from firmware_gen.projects.board import load_board

RUNTIME = Path(__file__).parents[1] / "firmware_gen" / "runtime"
FLAGS = (
    *("-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion"),
    *("-Wmissing-prototypes", "-Werror"),
)
RAM = 0x20000000
RAM_BYTES = 0x20000
OFF = b"off!"
WATCHDOG, FAULT, SUPPLY, CLOCK = range(1, 5)


@pytest.fixture(scope="module", params=["stm32f405", "mps2-an386"])
def tried(request, tmp_path_factory):
    """Return the image of `board_image.c` and its machine, compiled with the warnings of all of our C."""
    board = load_board(request.param)
    elf = tmp_path_factory.mktemp("board") / "board.elf"
    sources = [Path(__file__).with_name("board_image.c"), *(path for path in board.files if path.name in board.sources)]
    includes = [
        f"-I{folder}"
        for folder in (
            board.folder,
            board.folder.parent / board.core,
            RUNTIME,
            RUNTIME.parents[1] / "controller" / "runtime",
        )
    ]
    link = [flag.replace("{board}", str(board.folder)) for flag in board.link_flags]
    subprocess.run([board.compiler, *FLAGS, *board.flags, *includes, *sources, "-o", elf, *link], check=True)
    return elf, board.machine


@pytest.fixture
def machine(tried):
    with_board = Qemu(*tried)
    yield with_board
    with_board.close()


@pytest.fixture
def lamp():
    with_lamp = Qemu(image(XC330, "stm32f405"), "netduinoplus2")
    yield with_lamp
    with_lamp.close()


def run_to(machine, *names):
    """Let the image run freely, on its own clock and lines, to one of some functions; return the registers there."""
    return run_to_address(machine, *(machine.symbol(name).address for name in names))


def run_to_address(machine, *addresses):
    """Do the same, with addresses."""
    for address in addresses:
        machine.stub.add_breakpoint(address)
    while True:
        machine.stub.run()
        while not machine.stub.stopped():
            assert select([machine.stub], [], [], 20)[0], "the image comes nowhere"
            machine.stub.listen()
        registers = machine.stub.registers()
        if registers[PC] in addresses:
            for address in addresses:
                machine.stub.remove_breakpoint(address)
            return registers
        machine.stub.step()


def say(machine, data, answer=b""):
    """Let bytes come in on the bus's real UART, and the image run freely until it has answered; return all it said."""
    machine.lines["bus"].send(data)
    said = b""
    for _ in range(1000):
        machine.stub.step()
        run_to(machine, "sv_hal_wait")
        said += heard(machine) or starved()
        if said.endswith(answer):
            break
    return said


def starved():
    """Leave the processor to the emulator's other thread, which carries the bytes."""
    time.sleep(0.002)
    return b""


def heard(machine, line="bus"):
    return machine.lines[line].recv(65536) if select([machine.lines[line]], [], [], 0)[0] else b""


def lost(machine):
    return int.from_bytes(machine.stub.read_memory(machine.symbol("board_received").address + 10, 2), "little")


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_boots_and_sends_back(machine):
    taken = machine.resume(Given(0))
    assert (taken.until_us, taken.bus, taken.console) == (20000, (), b"h0")
    taken = machine.resume(Given(20000, bus=b"servo\nand another\n", console=b"?"))
    assert (taken.until_us, taken.bus, taken.console) == (40000, (b"servo\n", b"and another\n"), b"?")


def test_bytes_come_through_the_receive_interrupt(machine):
    run_to(machine, "sv_hal_wait")
    assert say(machine, b"through RXNE and ring\n", b"\n") == b"through RXNE and ring\n"
    assert lost(machine) == 0
    assert heard(machine, "console") == b"h0"


def test_time_goes_on_by_itself(machine):
    """Where no debugger moves it, the clock counts microseconds: a wait of 20 ms ends 20 ms later."""
    run_to(machine, "sv_hal_wait")
    until = []
    for _ in range(4):
        machine.stub.step()
        registers = run_to(machine, "sv_hal_wait")
        until.append(registers[0])
    gaps = [b - a for a, b in pairwise(until)]
    assert all(20000 <= gap <= 20100 for gap in gaps), gaps


def test_a_ring_that_overflows_loses_the_newest_and_no_more(machine):
    run_to(machine, "sv_hal_wait")
    machine.lines["bus"].send(b"Z\n" + b"x" * 2000)
    for _ in range(1000):
        machine.stub.step()
        run_to(machine, "sv_hal_wait")
        if lost(machine):
            break
    assert lost(machine) > 0
    gone = -1
    while gone != lost(machine):  # the rest of the flood is still on its way
        gone = lost(machine)
        for _ in range(50):
            machine.stub.step()
            run_to(machine, "sv_hal_wait")
            starved()
    assert say(machine, b"\n", b"\n").endswith(b"\n")  # deaf while it sends that back: the rest comes after it
    assert say(machine, b"as before\n", b"as before\n") == b"as before\n"


def test_the_debugger_overflows_it_the_same(machine):
    machine.resume(Given(0))
    machine.resume(Given(0, bus=b"y" * 5000, sensors=b"z" * 5000, console=b"c" * 5000))
    assert lost(machine) == 5000 - 256
    machine.resume(Given(0, bus=b"\n"))
    assert machine.resume(Given(0, bus=b"as before\n")).bus == (b"as before\n",)


def test_a_hung_main_loop_loses_the_torque_and_starts_anew(machine):
    machine.resume(Given(0))
    taken = machine.resume(Given(20000, bus=b"H\n"))
    assert taken.bus == (OFF, OFF, OFF)
    assert taken.console == b"h1"


@pytest.mark.parametrize("tried", ["mps2-an386"], indirect=True)
def test_the_mps2_watchdog_needs_no_interrupt(machine):
    machine.resume(Given(0))
    taken = machine.resume(Given(20000, bus=b"I\n"))
    assert taken.bus == (OFF, OFF, OFF)
    assert taken.console == b"h1"


# below the RAM of QEMU's MPS2 there is more of something, and a stack's overflow no fault
@pytest.mark.parametrize(
    ("tried", "command"), [("stm32f405", "J"), ("stm32f405", "R"), ("mps2-an386", "J")], indirect=["tried"]
)
def test_a_fault_loses_the_torque_and_starts_anew(machine, command):
    machine.resume(Given(0))
    taken = machine.resume(Given(20000, bus=command.encode() + b"\n"))
    assert taken.bus == (OFF, OFF, OFF)
    assert taken.console == b"h2"
    assert machine.resume(Given(40000, bus=b"as before\n")).bus == (b"as before\n",)


@pytest.mark.parametrize(
    ("tried", "command", "cause"),
    [
        ("stm32f405", "N", CLOCK),
        ("mps2-an386", "N", WATCHDOG),
        ("stm32f405", "P", SUPPLY),
        ("stm32f405", "U", FAULT),
        ("mps2-an386", "U", FAULT),
    ],
    indirect=["tried"],
)
def test_interrupts_that_end_it_all_take_the_torque_and_say_why(machine, command, cause):
    machine.resume(Given(0))
    taken = machine.resume(Given(20000, bus=command.encode() + b"\n"))
    assert taken.bus == (OFF, OFF, OFF)
    assert taken.console == f"h{cause}".encode()


def test_the_lamp_says_hello_and_computes_the_reference_bits(lamp):
    """The controller's selftest passes on the M4F, with the FPU as start-up code leaves it; then comes the hello."""
    back = run_to(lamp, "lamp_robust_selftest")[LR] & ~1
    assert run_to_address(lamp, back)[0] == 0
    taken = lamp.resume(Given(0))
    told = list(ConsoleDecoder(shape_of(XC330.rig, XC330.controller)).feed(taken.console))
    hello = next(record for record in told if isinstance(record, Hello))
    assert hello.reset == 0


def torque_off():
    """Return the packet that takes every servo's torque, built without the firmware.

    Source: Robotis e-Manual, protocol 2.0: sync write; X series: register 64, one byte.
    """
    ids = [joint.id for joint in XC330.rig.joints]
    return dxl.encode(0xFE, 0x83, bytes([64, 0, 1, 0]) + b"".join(bytes([servo, 0]) for servo in ids))


def test_the_lamp_takes_the_torque_at_boot_before_anything_else(lamp):
    run_to(lamp, "sv_hal_wait")
    assert heard(lamp) == torque_off()


def resets_told(machine):
    told = ConsoleDecoder(shape_of(XC330.rig, XC330.controller)).feed(heard(machine, "console"))
    return [record.reset for record in told if isinstance(record, Hello)]


def test_a_jump_into_nothing_takes_the_torque_of_the_lamp(lamp):
    """The debugger sends the program where no code is: torque off goes out for every servo, thrice, then all anew."""
    run_to(lamp, "sv_hal_wait")
    assert heard(lamp) == torque_off()
    lamp.stub.write_register(PC, 0xA0000000)
    run_to(lamp, "sv_hal_init")
    assert heard(lamp) == torque_off() * 3
    run_to(lamp, "sv_hal_wait")
    assert heard(lamp).startswith(torque_off())
    assert resets_told(lamp) == [0, 2]


def test_a_hung_main_loop_takes_the_torque_of_the_lamp(lamp):
    """The debugger turns a function into an endless loop: the tick notices, and the same packets go out."""
    run_to(lamp, "sv_hal_wait")
    assert heard(lamp) == torque_off()
    address = lamp.symbol("sv_hal_read").address
    was = lamp.stub.read_memory(address, 2)
    lamp.stub.write_memory(address, b"\xfe\xe7")  # b .
    run_to(lamp, "sv_hal_init")
    assert heard(lamp) == torque_off() * 3
    lamp.stub.write_memory(address, was)
    run_to(lamp, "sv_hal_wait")
    assert heard(lamp).startswith(torque_off())
    assert resets_told(lamp) == [0, 1]


def lamp_bytes(board="stm32f405", fill=None):
    """Run the lamp for 0.3 s on the virtual rig; return the digests of what went out on bus and console."""
    machine = Qemu(image(XC330, board), load_board(board).machine)
    try:
        if fill is not None:
            machine.stub.write_memory(RAM, random.Random(fill).randbytes(RAM_BYTES))
        sent, told = hashlib.sha256(), hashlib.sha256()
        bench = FirmwareBench(VirtualRig(XC330.rig), machine)
        for line in ("goal 0.4", "seconds 0.3", "arm", "start"):
            bench.say(line)
        packets = 0
        while bench.now < 2.5:
            _, taken = bench.wake()
            packets += len(taken.bus)
            sent.update(b"".join(taken.bus))
            told.update(taken.console)
            bench.send(taken)
            bench.wait(taken)
        return packets, sent.hexdigest(), told.hexdigest()
    finally:
        machine.close()


def test_the_same_bytes_every_time_whatever_the_memory_held_and_on_both_boards():
    once = lamp_bytes()
    assert once[0] > 100
    assert lamp_bytes() == once
    assert lamp_bytes(fill=1) == once
    assert lamp_bytes("mps2-an386") == once


def test_qemu_ends_with_close(tried):
    machine = Qemu(*tried)
    machine.resume(Given(0))
    pid = machine.pid
    machine.close()
    machine.close()
    assert not is_running(pid)
    with pytest.raises(RunError, match=r"gone|ended"):
        machine.resume(Given(0))


def test_an_image_that_never_waits_is_told_of(tried, monkeypatch):
    monkeypatch.setattr(qemu, "NOTHING_S", 0.3)
    machine = Qemu(*tried)
    try:
        machine.stub.write_memory(machine.symbol("sv_hal_reset_cause").address, b"\xfe\xe7")  # b .
        with pytest.raises(RunError, match=r"without coming to wait"):
            machine.resume(Given(0))
    finally:
        machine.close()


def test_symbols_are_those_of_nm(tried):
    listed = subprocess.run(["arm-none-eabi-nm", "-S", tried[0]], check=True, capture_output=True, text=True).stdout
    rows = [line.split() for line in listed.splitlines() if len(line.split()) == 4]
    symbols = read_symbols(tried[0])
    assert len(rows) > 20
    for address, size, _, name in rows:
        assert (symbols[name].address, symbols[name].size) == (int(address, 16), int(size, 16)), name


def test_wrong_images_and_machines_are_refused(tmp_path, tried):
    with pytest.raises(InputError, match="choose one of netduinoplus2, mps2-an386"):
        Qemu(tried[0], "microbit")
    with pytest.raises(InputError, match="build the firmware first"):
        Qemu(tmp_path / "none.elf", tried[1])
    for data in (b"", b"\x7fELF\x01\x01", Path("/proc/self/exe").read_bytes()[:4096]):
        (tmp_path / "wrong.elf").write_bytes(data)
        with pytest.raises(InputError, match="is not a 32-bit ELF image"):
            Qemu(tmp_path / "wrong.elf", tried[1])


def test_boards_and_machines_agree():
    assert {load_board(name).machine for name in ("stm32f405", "mps2-an386")} == set(BOARDS)
