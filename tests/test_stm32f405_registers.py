"""What the STM32F405's HAL writes to registers that QEMU does not have: its image runs with registers made of memory.

The addresses of the source are moved into the machine's RAM, where the debugger plays the hardware. What is expected
is ST's: RM0090's clock tree and register maps, with the bits of the CMSIS header stm32f405xx.h.
"""

import re
import struct
import subprocess

import pytest
from test_qemu import FLAGS, RUNTIME, run_to, run_to_address

from deploy.firmware.gdb_stub import LR
from deploy.firmware.qemu import Qemu
from firmware_gen.projects.board import load_board

APB1, APB2, AHB1 = 0x40000000, 0x40010000, 0x40020000
MOVED = {APB1: 0x20010000, APB2: 0x20018000, AHB1: 0x2001C000}
TIM2, IWDG, USART3, PWR = APB1, APB1 + 0x3000, APB1 + 0x4800, APB1 + 0x7000
USART1, USART6, EXTI = APB2 + 0x1000, APB2 + 0x1400, APB2 + 0x3C00
GPIOB, GPIOC, RCC, FLASH = AHB1 + 0x400, AHB1 + 0x800, AHB1 + 0x3800, AHB1 + 0x3C00
HSION_RDY, HSEON, HSERDY, CSSON, PLLON, PLLRDY = 3, 1 << 16, 1 << 17, 1 << 19, 1 << 24, 1 << 25
SR, BRR, CR1 = 0x00, 0x08, 0x0C
PUPDR, IDR = 0x0C, 0x10


def moved(address):
    return MOVED[address & 0xFFFF0000] + (address & 0xFFFF)


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    """Return the image of board_image.c over a HAL whose registers are memory."""
    board, folder = load_board("stm32f405"), tmp_path_factory.mktemp("registers")
    for path in board.files:
        text = re.sub(r"0x400[0-3]\w{4}U", lambda found: f"{moved(int(found[0][:-1], 16)):#x}U", path.read_text())
        (folder / path.name).write_text(text)
    sources = [RUNTIME.parents[1] / "tests" / "board_image.c", *(folder / name for name in board.sources)]
    includes = [f"-I{place}" for place in (folder, RUNTIME, RUNTIME.parents[1] / "controller" / "runtime")]
    link = [flag.replace("{board}", str(folder)) for flag in board.link_flags]
    elf = folder / "registers.elf"
    subprocess.run([board.compiler, *FLAGS, *board.flags, *includes, *sources, "-o", elf, *link], check=True)
    return elf


class Chip:
    """Stand between a test and the registers."""

    def __init__(self, image, **clock):
        self.machine = Qemu(image, "netduinoplus2")
        run_to(self.machine, "sv_hal_init")
        for line in (USART1, USART3, USART6):
            self[line + SR] = 1 << 6  # nothing is sent any more; no room, so that the console's ring keeps its bytes
        self[PWR] = 1 << 14  # VOS, as a reset leaves it
        self[RCC] = HSION_RDY | clock.get("ready", HSERDY | PLLRDY)
        self[RCC + 0x74] = clock.get("csr", 0)

    def boot(self):
        run_to(self.machine, "sv_hal_wait")
        return self

    def __getitem__(self, address):
        return int.from_bytes(self.machine.stub.read_memory(moved(address), 4), "little")

    def __setitem__(self, address, value):
        self.machine.stub.write_memory(moved(address), struct.pack("<I", value))

    def answers(self):
        ring = self.machine.stub.read_memory(self.machine.symbol("board_answers").address, 8)
        place, _, written = struct.unpack("<IHH", ring)
        return bytes(self.machine.stub.read_memory(place, written))

    def inputs(self):
        self.machine.stub.step()
        back = run_to(self.machine, "sv_hal_inputs")[LR] & ~1
        return run_to_address(self.machine, back)[0]


@pytest.fixture
def chip(image):
    chips = []

    def make(**clock):
        chips.append(Chip(image, **clock).boot())
        return chips[-1]

    yield make
    for made in chips:
        made.machine.close()


def test_the_crystal_makes_168_mhz_and_is_watched(chip):
    found = chip()
    assert found[RCC + 0x04] == 0x20000000 | 7 << 24 | 1 << 22 | 0 << 16 | 336 << 6 | 8  # 8 MHz / 8 * 336 / 2
    assert found[RCC] & (HSEON | PLLON | CSSON) == HSEON | PLLON | CSSON
    assert found[RCC + 0x08] == 4 << 13 | 5 << 10 | 2  # APB2 / 2, APB1 / 4, PLL
    assert found[FLASH] == 0x705
    assert found[TIM2 + 0x28] == 83
    assert found.answers() == b"h0"


def test_without_a_crystal_the_lines_keep_their_bit_rates_and_a_person_is_told(chip):
    found = chip(ready=PLLRDY)
    assert found[RCC + 0x04] == 0x20000000 | 7 << 24 | 0 << 22 | 0 << 16 | 336 << 6 | 16  # 16 MHz / 16 * 336 / 2
    assert found[RCC] & (PLLON | CSSON) == PLLON
    assert found[RCC + 0x08] & 3 == 2
    assert found.answers() == b"no crystal: clock within 4 %\r\nh0"
    rates = [mhz * 1e6 / found[line + BRR] for mhz, line in ((84, USART1), (42, USART3), (84, USART6))]
    assert rates == [pytest.approx(rate, rel=0.002) for rate in (1e6, 115200, 1e6)]
    assert [found[line + CR1] for line in (USART1, USART3, USART6)] == [0x202C, 0x202C, 0x20AC]  # TXEIE: it has words


def test_a_supply_below_2_9_v_interrupts(chip):
    found = chip()
    assert found[PWR] == 1 << 14 | 7 << 5 | 1 << 4  # VOS kept, PLS, PVDE
    assert (found[EXTI], found[EXTI + 0x08], found[EXTI + 0x0C]) == (1 << 16, 1 << 16, 0)  # IMR, RTSR, FTSR


def test_the_watchdog_that_needs_no_code_is_started_and_told_of(chip):
    found = chip(csr=1 << 29)
    assert (found[IWDG], found[IWDG + 0x04], found[IWDG + 0x08]) == (0xAAAA, 2, 500)
    assert found[RCC + 0x74] & 1 << 24  # RMVF
    assert found.answers() == b"h1"


def test_no_register_that_fails_later_closes_the_emergency_stop(chip):
    found = chip()
    found[GPIOB + IDR], found[GPIOC + IDR] = 0, 1 << 3
    assert found.inputs() == 0
    found[GPIOB + IDR] = 1 << 9
    assert found.inputs() == 1
    found[GPIOB + PUPDR] = 0
    assert found.inputs() == 1
    found[GPIOC + IDR] = 0
    assert found.inputs() == 3
