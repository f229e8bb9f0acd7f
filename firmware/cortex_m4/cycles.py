"""What an instruction costs at the most, in cycles of the processor.

An estimate from above by ARM DDI 0439 (instruction set summary): a load or store 2, a branch taken
4, a division 12, a register more of a list 1; a wait state of the flash, and two more for an access
that may be one of a peripheral or of flash. Reading a register is counted twice.
"""

from __future__ import annotations

from typing import Final

PLAIN, BRANCH, DIVISION, ACCESS, LIST = 2, 5, 13, 5, 2
TO_PC: Final = 4
EXCEPTION: Final = 24
"""To push eight words and be in the handler, and as long to be back."""
PC_BIT: Final = 1 << 15


def block_cycles(code: bytes) -> int:
    """Of instructions in a row, Thumb-2."""
    at = cycles = 0
    while at + 2 <= len(code):
        first = int.from_bytes(code[at : at + 2], "little")
        if first >> 11 in (0b11101, 0b11110, 0b11111):
            cycles += _wide(first, int.from_bytes(code[at + 2 : at + 4], "little"))
            at += 4
        else:
            cycles += _narrow(first)
            at += 2
    return cycles


def _narrow(code: int) -> int:
    """Of 16 bits."""
    if code >> 12 in (0b0101, 0b0110, 0b0111, 0b1000, 0b1001) or code >> 11 == 0b01001:
        return ACCESS
    if code >> 12 == 0b1100:
        return LIST + (code & 0xFF).bit_count()
    if code & 0xF600 == 0xB400:  # PUSH and POP, with LR or PC
        return LIST + (code & 0x1FF).bit_count() + (TO_PC if code >> 8 == 0xBD else 0)
    is_branch = (
        code >> 12 == 0b1101 or code >> 11 == 0b11100
        or code & 0xF500 == 0xB100  # CBZ, CBNZ
        or code & 0xFF00 == 0x4700  # BX, BLX
        or code & 0xFD87 == 0x4487  # ADD and MOV to PC
    )  # fmt: skip
    return BRANCH if is_branch else PLAIN


def _wide(first: int, second: int) -> int:
    """Of 32 bits."""
    if first & 0xFE40 == 0xE800:
        return LIST + second.bit_count() + (TO_PC if second & PC_BIT else 0)
    if first & 0xFE40 == 0xE840:  # LDRD, STRD, exclusive accesses, TBB
        return BRANCH if first & 0xFFF0 == 0xE8D0 and second & 0xFFE0 == 0xF000 else ACCESS + 1
    if first & 0xFE00 == 0xF800:
        return ACCESS + (TO_PC if first & 0x10 and second >> 12 == 0xF else 0)
    if first & 0xFFD0 == 0xFB90 and second & 0xF0 == 0xF0:
        return DIVISION
    is_branch = (
        first & 0xF800 == 0xF000
        and second & 0x8000
        and (second & 0x5000 or first & 0x0380 != 0x0380)
    )
    return BRANCH if is_branch else PLAIN
