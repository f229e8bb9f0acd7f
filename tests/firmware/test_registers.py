"""What the emulated chip's registers do, and which use of them is an error (RM0440)."""

from __future__ import annotations

import re
from collections.abc import Iterable

import pytest

from meshpoint.dbc.frame import Frame
from meshpoint.firmware.cortex_m4.chip import Chip, Outside
from meshpoint.firmware.cortex_m4.registers import RegisterError

RCC, FLASH, GPIOA = 0x4002_1000, 0x4002_2000, 0x4800_0000
CR, CFGR, PLLCFGR, AHB1ENR, AHB2ENR, APB1ENR1 = (RCC + at for at in (0, 8, 0xC, 0x48, 0x4C, 0x58))
TIM2, TIM3, IWDG, FDCAN, DMA1 = 0x4000_0000, 0x4000_0400, 0x4000_3000, 0x4000_6400, 0x4002_0000
ADC1, ADC_COMMON, SCB = 0x5000_0000, 0x5000_0300, 0xE000_ED00
HSE_PLL = 2 << 20 | 1 << 24 | 20 << 8 | 2 << 4 | 3
"""24 MHz / 3 * 20 / 2 = 80 MHz."""
CLOCKS = ((AHB1ENR, 0x107), (AHB2ENR, 1 << 13 | 7), (APB1ENR1, 0x0200_043F))
IN_SETUP = (*CLOCKS, (FDCAN + 0x18, 1), (FDCAN + 0x18, 3))
Writes = tuple[tuple[int, int], ...]


class Bench:
    """A chip without a processor."""

    def __init__(self) -> None:
        self.memory: dict[int, bytes] = {}
        self.outputs: list[tuple[int, tuple[str, int], bool]] = []
        outside = Outside(
            lambda address, size: self.memory.get(address, b"").ljust(size, b"\0"),
            self.memory.__setitem__, {}, lambda _port, _value: None,
            lambda pin, level, at_us: self.outputs.append((at_us, pin, level)),
        )  # fmt: skip
        self.chip = Chip(outside, 0, 0)

    def write(self, *writes: tuple[int, int]) -> None:
        for address, value in writes:
            self.chip.write(address, 4, value)

    def read(self, address: int) -> int:
        return self.chip.read(address, 4)

    def go_to(self, now_us: int) -> None:
        """Time goes on, and what is due in it is done."""
        while (at_us := self.chip.next_us) is not None and at_us <= now_us:
            self.chip.now_us = at_us
            self.chip.step()
        self.chip.now_us = now_us


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(
    ("before", "wrong", "said"),
    [
        ((), (TIM2, 1), "TIM2: is used without its clock, bit 0 of RCC.APB1ENR1"),
        (CLOCKS, (TIM2 + 0x44, 1), "TIM2: no register at offset 0x044"),
        (CLOCKS, (TIM3 + 0x2C, 0xFFFF_FFFF), "TIM3.ARR: 0xFFFFFFFF is written; bits 0xFFFF0000"),
        (CLOCKS, (TIM2 + 0x18, 6 << 4), "TIM2.CCMR1: 0x00000060: a mode"),
        (CLOCKS, (TIM3 + 0x08, 4), "TIM3.SMCR: 0x00000004: of slave modes only"),
        ((), (0x4000_1800, 1), "0x40001800: no register of a peripheral that is modelled"),
        ((), (CFGR, 3), "RCC.CFGR: SW is 3: a clock that does not run"),
        ((), (CFGR, 0x400 | 1), "RCC.CFGR: bus prescalers are not modelled"),
        (((CR, 0x1_0500), (PLLCFGR, HSE_PLL), (CR, 0x101_0500)), (CFGR, 3),
         "HCLK is 80000000 Hz with 0 wait states of the flash; needed are 2"),
        (((CR, 0x1_0500), (PLLCFGR, HSE_PLL), (CR, 0x101_0500)), (PLLCFGR, 0),
         "RCC.PLLCFGR: is written while CR.PLLON is 1"),
        (((PLLCFGR, HSE_PLL),), (CR, 0x100_0500), "PLLSRC is 3: no clock that is on"),
        (((PLLCFGR, HSE_PLL & ~3 | 2 | 1 << 14),), (CR, 0x100_0500), "to 447999972 Hz; allowed"),
        ((), (IWDG + 8, 15), "IWDG.RLR: is written without the key 0x5555"),
        ((), (IWDG, 1), "IWDG.KR: 0x0001 is written; allowed are"),
        (CLOCKS, (FDCAN + 0x1C, 0), "FDCAN1.NBTP: is written while CCCR does not have INIT and"),
        (IN_SETUP, (FDCAN + 0x18, 0), "FDCAN1.NBTP: 1500000 bit/s, sampled at 75 %; this bus has"),
        ((*CLOCKS, (FDCAN + 0x18, 1)), (FDCAN + 0x18, 0x101), "bits 0x0100 are changed without"),
        (CLOCKS, (FDCAN + 0xCC, 2), "FDCAN1.TXBAR: buffer 1 is requested; next is 0"),
        (CLOCKS, (FDCAN + 0xD0, 1), "FDCAN1.TXBCR: is written while TXBC.TFQM is 0"),
        (CLOCKS, (FDCAN + 0x94, 0), "FDCAN1.RXF0A: element 0 is given back, of 0 from 0 on"),
        ((*CLOCKS, (DMA1 + 0xC, 8), (DMA1 + 8, 0x81)), (DMA1 + 0xC, 9),
         "DMA1.CNDTR1: is written while CCR1.EN is 1"),
        (CLOCKS, (DMA1 + 8, 1), "DMA1.CCR1: 0x00000001: only from one register to memory"),
        (CLOCKS, (ADC1 + 8, 1), "ADC1.CR: bit 0x00000001 is set while ADVREGEN is 0"),
        (CLOCKS, (ADC1 + 8, 1 << 31), "ADC1.CR: bit 0x80000000 is set while ADVREGEN is 0"),
        ((*CLOCKS, (ADC1 + 8, 1 << 28)), (ADC1 + 8, 1 << 28 | 1), "there is no clock"),
        ((*CLOCKS, (ADC1 + 8, 1 << 28)), (ADC1 + 8, 1 << 28 | 4), "while ADEN is 0"),
        ((*CLOCKS, (ADC_COMMON + 8, 1 << 16), (GPIOA, 0xABFF_FFF3), (ADC1 + 8, 1 << 28),
          (ADC1 + 8, 1 << 28 | 1), (ADC1 + 0x30, 2 << 6)), (ADC1 + 8, 1 << 28 | 5),
         "ADC1.SQR1: channel 2 is no pin in analogue mode"),
        ((), (SCB + 0xC, 4), "SCB.AIRCR: written with the key 0x0000, not 0x05FA"),
        ((), (SCB + 0x10, 4), "SCB.SCR: SLEEPONEXIT, SLEEPDEEP and SEVONPEND are not modelled"),
    ],
)  # fmt: skip
def test_a_wrong_use_is_an_error_that_names_the_register(
    bench: Bench, before: Writes, wrong: tuple[int, int], said: str
) -> None:
    bench.write(*before)
    with pytest.raises(RegisterError, match=re.escape(said)):
        bench.write(wrong)


def test_a_register_is_a_word(bench: Bench) -> None:
    with pytest.raises(RegisterError, match="RCC: 1 bytes are written; allowed is a word"):
        bench.chip.write(RCC, 1, 1)
    with pytest.raises(RegisterError, match="RCC: 2 bytes are read; allowed is a word"):
        bench.chip.read(RCC, 2)


def test_clocks_are_ready_as_they_are_on_and_the_pll_gives_80_mhz(bench: Bench) -> None:
    assert bench.read(CR) == 0x500
    bench.write((CR, 0x1_0500), (PLLCFGR, HSE_PLL), (CR, 0x101_0500), (FLASH, 0x4_0602), (CFGR, 3))
    assert (bench.read(CR), bench.read(CFGR)) == (0x303_0500, 0xF)
    assert bench.chip.rcc.hclk_hz == 80_000_000


def test_a_prescaler_counts_from_the_next_update_on(bench: Bench) -> None:
    """The mistake to forget EGR.UG shows: the counter runs at the clock of the timer."""
    bench.write(*CLOCKS, (TIM2 + 0x28, 15), (TIM2, 1))
    bench.go_to(10)
    assert bench.read(TIM2 + 0x24) == 160
    bench.write((TIM2 + 0x14, 1))
    bench.go_to(20)
    assert bench.read(TIM2 + 0x24) == 10


def test_a_value_that_is_the_counters_as_it_is_written_does_not_match(bench: Bench) -> None:
    bench.write(*CLOCKS, (TIM2 + 0x28, 15), (TIM2 + 0x14, 1), (TIM2 + 0x10, 0), (TIM2, 1))
    bench.go_to(50)
    bench.write((TIM2 + 0x34, 50), (TIM2 + 0x38, 51))
    bench.go_to(60)
    assert bench.read(TIM2 + 0x10) & 0b110 == 0b100
    bench.write((TIM2 + 0x14, 0b10))  # made by software
    assert bench.read(TIM2 + 0x10) & 0b110 == 0b110


def test_a_capture_that_nobody_took_is_said_to_be_lost(bench: Bench) -> None:
    bench.write(
        *CLOCKS, (GPIOA, 0xABFF_FFFE), (GPIOA + 0x20, 1), (TIM2 + 0x18, 1), (TIM2 + 0x20, 1)
    )
    bench.chip.edges(("A", 0), rising=True, counts=[5])
    assert bench.read(TIM2 + 0x10) == 0b10
    assert bench.read(TIM2 + 0x34) == 5
    assert bench.read(TIM2 + 0x10) == 0
    bench.chip.edges(("A", 0), rising=True, counts=[6])
    bench.chip.edges(("A", 0), rising=True, counts=[7])
    assert bench.read(TIM2 + 0x10) == 1 << 9 | 0b10


def test_pins_are_set_and_cleared_and_read_back(bench: Bench) -> None:
    bench.write(*CLOCKS, (GPIOA, 0xABFF_FFF5), (GPIOA + 0x18, 0b111), (GPIOA + 0x18, 1 << 16))
    assert bench.read(GPIOA + 0x10) == 0b10  # pin 2 is none that is driven
    assert bench.chip.ports["A"].driven == 0b10


@pytest.mark.parametrize(("at_us", "is_reset"), [(374, True), (375, False), (1_999, False)])
def test_a_watchdog_that_is_restarted_before_its_window_resets_at_once(
    bench: Bench, at_us: int, is_reset: bool
) -> None:
    start: Writes = ((IWDG, 0xCCCC), (IWDG, 0x5555), (IWDG + 8, 15), (IWDG + 0x10, 12))
    bench.write(*start)
    bench.go_to(at_us)
    bench.write((IWDG, 0xAAAA))
    assert bool(bench.chip.reset_by) == is_reset
    bench.go_to(at_us + 1_999)
    assert bool(bench.chip.reset_by) == is_reset
    bench.go_to(at_us + 2_000)
    assert bench.chip.reset_by


ON_THE_BUS: Writes = (
    *IN_SETUP, (RCC + 0x88, 2 << 24), (FDCAN + 0x18, 0x303), (FDCAN + 0x1C, 1 << 16 | 11 << 8 | 2),
    (FDCAN + 0x0C, 4 << 8 | 1 << 4), (FDCAN + 0x18, 0x300),
)  # fmt: skip
FRAME = Frame(0x18FF_1080, bytes(64))


def test_a_receive_fifo_that_is_full_loses_the_next_frame_and_says_so(bench: Bench) -> None:
    bench.write(*ON_THE_BUS)
    for _ in range(4):
        bench.chip.fdcan.receive(FRAME)
    assert bench.read(FDCAN + 0x90) & 0x100_000F == 1 << 24 | 3
    assert bench.read(FDCAN + 0x50) == 0b111
    bench.write((FDCAN + 0x94, 1), (FDCAN + 0x50, 0b111))  # two are given back at once
    assert (bench.read(FDCAN + 0x90) & 0xF, bench.read(FDCAN + 0x50)) == (1, 0)


def test_filters_let_in_what_they_name(bench: Bench) -> None:
    accepted = 0x18FF_1080
    bench.memory[0x4000_A400 + 0x70] = (1 << 29 | accepted).to_bytes(4, "little") + (
        1 << 30 | accepted
    ).to_bytes(4, "little")
    bench.write(*ON_THE_BUS[:-1], (FDCAN + 0x80, 1 << 24 | 3 << 4 | 3 << 2), ON_THE_BUS[-1])
    for frame in (FRAME, FRAME._replace(can_id=1), Frame(1, b"", is_extended=False)):
        bench.chip.fdcan.receive(frame)
    assert bench.read(FDCAN + 0x90) & 0xF == 1


@pytest.mark.parametrize(
    ("kind", "let_in"), [(0, range(0x100, 0x104)), (1, (0x100, 0x103)), (2, range(0x100, 0x104))]
)
def test_a_filter_s_first_and_last_identifier_belong_to_it(
    kind: int, let_in: Iterable[int], bench: Bench
) -> None:
    """A range, two identifiers, or one with a mask."""
    second = 0x1FFF_FFFC if kind == 2 else 0x103
    bench.memory[0x4000_A400 + 0x70] = (1 << 29 | 0x100).to_bytes(4, "little") + (
        kind << 30 | second
    ).to_bytes(4, "little")
    bench.write(*ON_THE_BUS[:-1], (FDCAN + 0x80, 1 << 24 | 3 << 4 | 3 << 2), ON_THE_BUS[-1])
    found = []
    for can_id in range(0xFE, 0x107):
        bench.chip.fdcan.receive(FRAME._replace(can_id=can_id))
        if bench.read(FDCAN + 0x90) & 0xF:
            found.append(can_id)
            bench.write((FDCAN + 0x94, bench.read(FDCAN + 0x90) >> 8 & 3))
    assert found == list(let_in)


def test_bus_off_is_left_after_129_times_11_bits(bench: Bench) -> None:
    bench.write(*ON_THE_BUS)
    bench.chip.fdcan.go_bus_off()
    assert (bench.read(FDCAN + 0x44) & 1 << 7, bench.read(FDCAN + 0x18) & 1) == (1 << 7, 1)
    bench.go_to(1_000_000)
    bench.write((FDCAN + 0x18, 0x300))
    bench.go_to(1_002_837)
    assert bench.read(FDCAN + 0x44) & 1 << 7
    bench.go_to(1_002_838)
    assert not bench.read(FDCAN + 0x44) & 1 << 7
