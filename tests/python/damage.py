# SPDX-License-Identifier: BSD-3-Clause
"""Damages files as disks, networks, careless programs and strangers do: the same for the same seed."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random

#: Of lengths, counts and offsets: what overflows, allocates, or divides by zero.
_INTEGERS = (
    0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1,
)  # fmt: skip
_WORDS = (
    b"nan", b"inf", b"-inf", b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"1e999", b"9" * 300,
    b"18446744073709551616", b"-9223372036854775809", b"", b"x", b"0x10", b"\xff\xfe", b"\0", b"1 2", b"[]",
    b"&a [*a]", b"../../../dev/zero", b"1.5", b"4294967296", b"1000000000000",
)  # fmt: skip
_WORD = re.compile(rb"[^\s,:;()\[\]]+")
#: Headers and footers say how the rest is read: half of the damage is there.
_EDGE = 600


def damaged(content: bytes, random: Random) -> bytes:
    """Content with one to three damages."""
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        content = random.choice(_WAYS)(content, random)
    return content


def _place(content: bytes, random: Random) -> int:
    if not content:
        return 0
    where = random.random()
    if where < 0.35:
        return random.randrange(min(len(content), _EDGE))
    if where < 0.5:
        return random.randrange(max(0, len(content) - _EDGE), len(content))
    return random.randrange(len(content))


def _length(random: Random) -> int:
    return int(2 ** random.uniform(0, 8))


def _with_bits_flipped(content: bytes, random: Random) -> bytes:
    changed = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 8))):
        if changed:
            changed[_place(content, random)] ^= 1 << random.randrange(8)
    return bytes(changed)


def _with_noise(content: bytes, random: Random) -> bytes:
    at, noise = _place(content, random), random.randbytes(_length(random))
    return content[:at] + noise + content[at + len(noise) :]


def _with_an_integer(content: bytes, random: Random) -> bytes:
    size = random.choice((1, 2, 4, 4, 8))
    at = _place(content, random)
    value = random.choice(_INTEGERS) & (2 ** (8 * size) - 1)
    packed = value.to_bytes(size, random.choice(("little", "little", "big")))
    return content[:at] + packed + content[at + size :]


def _with_a_float(content: bytes, random: Random) -> bytes:
    value = random.choice((float("nan"), float("inf"), -1e300, 1e300, 1e-310, 0.0))
    packed = struct.pack("<f" if random.random() < 0.5 and abs(value) < 1e38 else "<d", value)
    at = _place(content, random)
    return content[:at] + packed + content[at + len(packed) :]


def _cut(content: bytes, random: Random) -> bytes:
    return content[: _place(content, random)]


def _with_a_hole(content: bytes, random: Random) -> bytes:
    at = _place(content, random)
    return content[:at] + content[at + _length(random) :]


def _with_zeros(content: bytes, random: Random) -> bytes:
    at, length = _place(content, random), _length(random)
    return content[:at] + bytes(len(content[at : at + length])) + content[at + length :]


def _with_a_part_twice(content: bytes, random: Random) -> bytes:
    at, length, to = _place(content, random), _length(random), _place(content, random)
    return content[:to] + content[at : at + length] + content[to:]


def _with_a_word(content: bytes, random: Random) -> bytes:
    words = list(_WORD.finditer(content[: 1 << 20]))
    if not words:
        return _with_noise(content, random)
    word = random.choice(words[: random.choice((8, 40, len(words)))])
    return content[: word.start()] + random.choice(_WORDS) + content[word.end() :]


def _with_a_line_less_or_twice(content: bytes, random: Random) -> bytes:
    lines = content.split(b"\n")
    at = random.randrange(len(lines))
    lines[at : at + 1] = random.choice(([], [lines[at]] * 2, [b""], [lines[at] + b" " + lines[at]]))
    return b"\n".join(lines)


_WAYS: tuple[Callable[[bytes, Random], bytes], ...] = (
    _with_bits_flipped, _with_noise, _with_an_integer, _with_an_integer, _with_a_float, _cut, _with_a_hole,
    _with_zeros, _with_a_part_twice, _with_a_word, _with_a_word, _with_a_line_less_or_twice,
)  # fmt: skip


# --- Checksums, which would hide what is behind them ------------------------------------------------


def mended(name: str, content: bytes) -> bytes:
    """Content whose checksums are right again, of formats that have some."""
    if content.startswith(b"\x89NDT") and len(content) > 24:
        body = content[:12] + struct.pack("<Q", len(content) - 24) + content[20:-4]
        return body + struct.pack("<I", zlib.crc32(body))
    if content.startswith(b"\x89PNG"):
        return _mended_png(content)
    if name.endswith(".mcap"):  # 0 is "not computed".
        return content[:-12] + bytes(4) + content[-8:]
    return content


def _mended_png(content: bytes) -> bytes:
    at, out = 8, content[:8]
    while at + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        if at + 12 + length > len(content):
            break
        chunk = content[at + 4 : at + 8 + length]
        out += content[at : at + 4] + chunk + struct.pack(">I", zlib.crc32(chunk))
        at += 12 + length
    return out + content[at:]


def damage_one(folder: Path, seed: str) -> str:
    """Damage one of a folder's files; says which, and how long it has become."""
    random = Random(seed)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    file = random.choice(files)
    content = damaged(file.read_bytes(), random)
    if random.random() < 0.5:
        content = mended(file.name, content)
    file.write_bytes(content)
    return f"{file.relative_to(folder)} ({len(content)} bytes)"
