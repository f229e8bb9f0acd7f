"""A CAN frame written out bit by bit, as ISO 11898-1 lists its fields: slow, plain, and sharing
nothing with the product. Each bit stands with its rate, "n" (nominal) or "d" (data)."""

from __future__ import annotations

POLYNOMIALS = {15: 0x4599, 17: 0x1685B, 21: 0x102899}
LENGTHS = {9: 12, 10: 16, 11: 20, 12: 24, 13: 32, 14: 48, 15: 64}
Bits = list[tuple[int, str]]


def number(value: int, width: int) -> list[int]:
    return [int(digit) for digit in format(value, f"0{width}b")] if width else []


def crc(bits: list[int], width: int, start: int) -> list[int]:
    register = start
    for bit in bits:
        top = register >> (width - 1)
        register = (register << 1) & ((1 << width) - 1)
        if top != bit:
            register ^= POLYNOMIALS[width]
    return number(register, width)


def stuffed(bits: list[tuple[int, str]], at_end: bool) -> Bits:
    """With a complementary bit after five equal ones; `at_end`: also behind the last bit."""
    out: Bits = []
    for index, (bit, rate) in enumerate(bits):
        out.append((bit, rate))
        last = [b for b, _ in out[-5:]]
        if len(last) == 5 and len(set(last)) == 1 and (at_end or index + 1 < len(bits)):
            following = bits[index + 1][1] if index + 1 < len(bits) else rate
            out.append((1 - bit, following))
    return out


def encode(
    can_id: int,
    data: bytes,
    *,
    fd: bool,
    extended: bool,
    brs: bool = False,
    esi: bool = False,
    remote_dlc: int | None = None,
) -> Bits:
    """Start of frame to end of frame."""
    dlc = len(data) if len(data) <= 8 else {v: k for k, v in LENGTHS.items()}[len(data)]
    remote = remote_dlc is not None
    if remote:
        dlc = remote_dlc or 0
    header = [0]
    if extended:
        header += [*number(can_id >> 18, 11), 1, 1, *number(can_id & 0x3FFFF, 18)]
        header += [int(remote)]
        header += [1, 0, int(brs)] if fd else [0, 0]
    else:
        header += [*number(can_id, 11), int(remote), 0]
        header += [1, 0, int(brs)] if fd else [0]
    payload = [bit for byte in data for bit in number(byte, 8)]
    if not fd:
        body = header + number(dlc, 4) + payload
        body += crc(body, 15, 0)
        out = stuffed([(bit, "n") for bit in body], at_end=True)
        return out + [(1, "n"), (0, "n"), (1, "n")] + [(1, "n")] * 7
    fast = "d" if brs else "n"
    body_bits = [(bit, "n") for bit in header]
    body_bits += [(bit, fast) for bit in [int(esi), *number(dlc, 4), *payload]]
    out = stuffed(body_bits, at_end=False)
    count = (len(out) - len(body_bits)) % 8
    gray = number(count ^ count >> 1, 3)
    tail = [*gray, sum(gray) % 2]
    width = 17 if len(data) <= 16 else 21
    tail += crc([bit for bit, _ in out] + tail, width, 1 << (width - 1))
    for index, bit in enumerate(tail):
        if index % 4 == 0:
            out.append((1 - out[-1][0], fast))
        out.append((bit, fast))
    return out + [(1, fast), (0, "n"), (1, "n")] + [(1, "n")] * 7
