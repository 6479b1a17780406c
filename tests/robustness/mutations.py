"""Random damage to the bytes of a valid file."""

import re
from collections.abc import Callable

import numpy as np

Random = np.random.Generator
EXTREMES = (
    b"0", b"-1", b"1", b"7", b"255", b"256", b"65535", b"65536", b"2147483647", b"2147483648",
    b"4294967295", b"4294967296", b"9223372036854775807", b"18446744073709551616", b"1e308",
    b"-1e308", b"1e-308", b"nan", b"inf", b"-inf", b"0x7f", b"1.5", b"1,5", b"", b"9" * 400,
    b"9" * 5000, b"/etc/passwd", b"../../secret.txt", b"{0}", b"%s", b"[" * 2000, b"\0",
)  # fmt: skip
LINES = (
    b"data file: /etc/passwd", b" data file: secret.txt", b"datafile: LIST", b"line skip: 99999999",
    b"*INCLUDE, INPUT=/etc/passwd", b"a: !!binary L2V0Yy9wYXNzd2Q=", b"<<: *a", b"&a [*a, *a]",
    b"POINTS 999999999999 float", b"$Nodes", b"\xff\xfe\0", b"#" * 5000, b"!!set {/etc/passwd}",
    b"- - - - - - - -", b"\xef\xbb\xbf", b"\r\r\n", b"field: x" * 500,
)  # fmt: skip
_NUMBERS = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
WORDS = tuple(
    value.to_bytes(size, order, signed=value < 0)
    for size in (1, 2, 4, 8)
    for order in ("little", "big")
    for value in (0, 1, -1, 2 ** (8 * size - 1) - 1, -(2 ** (8 * size - 1)))
)


def _cut(data: bytes, random: Random) -> bytes:
    return data[: int(random.integers(0, len(data) + 1))]


def _flip(data: bytes, random: Random) -> bytes:
    out = bytearray(data)
    most = len(out) if random.random() < 0.5 else min(len(out), 600)
    for _ in range(int(random.integers(1, 9))):
        if most:
            out[int(random.integers(0, most))] = int(random.integers(0, 256))
    return bytes(out)


def _number(data: bytes, random: Random) -> bytes:
    found = [match.span() for match in _NUMBERS.finditer(data[:20_000])]
    if not found:
        return _word(data, random)
    low, high = found[int(random.integers(0, len(found)))]
    return data[:low] + EXTREMES[int(random.integers(0, len(EXTREMES)))] + data[high:]


def _word(data: bytes, random: Random) -> bytes:
    word = WORDS[int(random.integers(0, len(WORDS)))]
    at = int(random.integers(0, max(1, min(len(data), 2000))))
    return data[:at] + word + data[at + len(word) :]


def _line(data: bytes, random: Random) -> bytes:
    lines = data.split(b"\n")
    at = int(random.integers(0, min(len(lines), 60) + 1))
    action = int(random.integers(0, 4))
    if action == 0:
        lines.insert(at, LINES[int(random.integers(0, len(LINES)))])
    elif action == 1 and at < len(lines):
        lines.insert(at, lines[at])
    elif action == 2 and at < len(lines):
        del lines[at]
    else:
        other = int(random.integers(0, min(len(lines), 60)))
        at = min(at, len(lines) - 1)
        lines[at], lines[other] = lines[other], lines[at]
    return b"\n".join(lines)


def _repeat(data: bytes, random: Random) -> bytes:
    low, high = sorted(int(n) for n in random.integers(0, len(data) + 1, 2))
    return data[:high] + data[low:high] * int(random.integers(1, 20)) + data[high:]


def _remove(data: bytes, random: Random) -> bytes:
    low = int(random.integers(0, len(data) + 1))
    return data[:low] + data[low + int(random.integers(1, 64)) :]


DAMAGES: tuple[Callable[[bytes, Random], bytes], ...] = (
    _cut, _flip, _flip, _number, _number, _number, _word, _word, _line, _line, _repeat, _remove,
)  # fmt: skip
MOST_BYTES = 2**22


def damaged(data: bytes, random: Random) -> bytes:
    """Return data with one to three random damages."""
    for _ in range(int(random.integers(1, 4))):
        data = DAMAGES[int(random.integers(0, len(DAMAGES)))](data, random)[:MOST_BYTES]
    return data
