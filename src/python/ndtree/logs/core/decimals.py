# SPDX-License-Identifier: BSD-3-Clause
"""Decimal numbers of a table in text, many at a time and exactly.

Strategy: where fields begin and end is found for a block of lines at once, between blanks and separators.
The last 16 bytes of a field are two words of 64 bits. In these, the decimal point is taken out, and eight
digits become a number by three multiplications. The digits of a field are a whole number m, of which k are
behind the point: m / 10^k is the nearest double, as both are exact (15 digits beside a point) and a division
rounds once. A few other fields, as 1e-7, nan or those of more digits, are read one by one.

Invariant: a number is returned only if `float` makes the same of its field. Cost: 50 to 100 ns a field.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Words = NDArray[np.uint64]
Indices = NDArray[np.intp]

_WINDOW = 16  # Bytes of a field that are looked at: two words.
#: Of this share of the fields, each may be read alone.
_MOST_ALONE = 1 / 16


def _everywhere(byte: int) -> np.uint64:
    return np.uint64(byte * 0x0101010101010101)


_ZEROS, _ONES = _everywhere(ord("0")), _everywhere(1)
#: What a point is, when the code of 0 is taken away bit by bit.
_POINT = np.uint64(ord(".") ^ ord("0"))
_ABOVE_9, _TOP = _everywhere(0x80 - 10), _everywhere(0x80)
_PAIRS, _FOURS, _EIGHT = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0000FFFF0000FFFF), np.uint64(0xFFFFFFFF)
#: The k-th byte of this is k: 256^j times it has 7 - j in its last one, which are the digits behind a point.
_BEHIND = np.uint64(0x0706050403020100)
_KEEP_LAST, _KEEP_FIRST = (
    np.array([((1 << 64) - 1) << 8 * (8 - min(max(n, 0), 8)) & ((1 << 64) - 1) for n in lengths], np.uint64)
    for lengths in (range(_WINDOW + 1), range(-8, _WINDOW - 7))
)
_POWERS = 10.0 ** np.arange(_WINDOW)
_U = [np.uint64(value) for value in range(256)]


def decimals(
    block: bytes, separator: bytes | None, columns: tuple[int, ...], *, count: int | None = None
) -> Floats | None:
    """Numbers in some columns of lines that all have as many fields as the first.

    Parameters
    ----------
    block : bytes
        Whole lines.
    separator : bytes or None
        One byte between two fields, which may have blanks behind it; None for blanks.
    columns : tuple of int
    count : int, optional
        How many fields a line must have; left out, as many as the first line.

    Returns
    -------
    (lines, columns) float64 or None
        None where the lines are not all alike, or where many fields are no plain decimal numbers.
    """
    if b"\r" in block and block.count(b"\r") != block.count(b"\r\n"):  # Some take it for the end of a line.
        return None
    text = np.frombuffer(b"\n" * _WINDOW + block + b"\n", np.uint8)
    fields = _fields(text, separator, max(columns) + 1)
    if fields is None or (count is not None and fields[0].shape[1] != count):
        return None
    found = np.empty((len(fields[0]), len(columns)))
    for i, column in enumerate(columns):
        values = _numbers(text, *(np.ascontiguousarray(places[:, column]) for places in fields))
        if values is None:
            return None
        found[:, i] = values
    return found


def _fields(text: NDArray[np.uint8], separator: bytes | None, least: int) -> tuple[Indices, Indices] | None:
    """(lines, fields) where fields begin and end; None unless all lines have as many, and at least some."""
    inside = (text - np.uint8(ord("\t")) > ord("\r") - ord("\t")) & (text != ord(" "))
    if separator is not None:
        inside &= text != separator[0]
    edges = np.flatnonzero(inside[1:] != inside[:-1]) + 1
    begins, ends = edges[::2], edges[1::2]
    newlines = np.flatnonzero(text == ord("\n"))[_WINDOW:]
    if not len(begins):
        return None
    width = int(np.searchsorted(begins, newlines[0]))
    lines = len(begins) // max(width, 1)
    if width < least or lines * width != len(begins) or not lines <= len(newlines) <= lines + 1:
        return None
    begins, ends, newlines = begins.reshape(-1, width), ends.reshape(-1, width), newlines[:lines]
    if (ends[:, -1] > newlines).any() or (begins[1:, 0] < newlines[:-1]).any():
        return None
    if separator is not None:
        count = int(np.count_nonzero(text == separator[0]))
        if count != lines * (width - 1) or (text[ends[:, :-1]] != separator[0]).any():
            return None
    return begins, ends


def _numbers(text: NDArray[np.uint8], begins: Indices, ends: Indices) -> Floats | None:
    """Values of fields; None where many have to be read alone, or one is no number."""
    first = text[begins]
    negative = first == ord("-")
    lengths = ends - begins - (negative | (first == ord("+")))
    longest = int(lengths.max())
    alone = lengths > _WINDOW
    lengths = np.minimum(lengths, _WINDOW)
    # Windows of 8 bytes at any place: text of 8 bytes has no alignment.
    windows = np.ndarray((len(text) - 7,), "V8", text, 0, (1,))
    last = (_words(windows, ends - 8) ^ _ZEROS) & _KEEP_LAST[lengths]
    last, points = _without_point(last)
    bad = _is_bad(last, points)
    behind = (points * _BEHIND) >> _U[56]
    has_point = points != _U[0]
    if longest > 8:
        early = (_words(windows, ends - _WINDOW) ^ _ZEROS) & _KEEP_FIRST[lengths]
        early, early_points = _without_point(early)
        bad |= _is_bad(early, early_points)
        has_early = early_points != _U[0]
        bad |= has_point & has_early
        # The digits before the point move to it by one byte.
        last = _closed(last, points) | np.where(has_point, early >> _U[56], _U[0])
        early = np.where(has_point, early << _U[8], _closed(early, early_points))
        behind = np.where(has_early, ((early_points * _BEHIND) >> _U[56]) + _U[8], behind)
        whole = _value(early) * np.uint64(10**8) + _value(last)
        has_point |= has_early
    else:
        whole = _value(_closed(last, points))
    bad |= alone | (lengths <= has_point)
    found: Floats = whole.astype(np.float64) / _POWERS.take(behind.astype(np.intp), mode="clip")
    np.negative(found, out=found, where=negative)
    wrong = np.flatnonzero(bad)
    if len(wrong) > _MOST_ALONE * len(found):
        return None
    for i in wrong.tolist():
        try:
            found[i] = float(text[begins[i] : ends[i]].tobytes())
        except ValueError:
            return None
    return found


def _words(windows: NDArray[np.void], begins: Indices) -> Words:
    """Eight bytes each as a number, the first of which is the lowest byte."""
    return windows[begins].view("<u8").astype(np.uint64, copy=False)


def _without_point(digits: Words) -> tuple[Words, Words]:
    """Digits with 0 in place of a decimal point, and 1 in the byte where it was; see `_is_bad` for others."""
    points = (digits >> _U[4]) & _ONES
    return digits ^ (points * _POINT), points


def _is_bad(digits: Words, points: Words) -> NDArray[np.bool_]:
    """Whether a byte is neither a digit nor a point, or there are several points."""
    above = (digits | (digits + _ABOVE_9)) & _TOP
    others = digits & (points * _U[255])
    several = points & (points - _U[1])
    bad: NDArray[np.bool_] = (above | others | several) != _U[0]
    return bad


def _closed(digits: Words, points: Words) -> Words:
    """Digits with those before the point moved to it; as they are where there is none."""
    before = np.where(points != _U[0], points - _U[1], _U[0])
    return (digits & ~before) | ((digits & before) << _U[8])


def _value(digits: Words) -> Words:
    """The number that eight digits make, the first of which is the lowest byte."""
    pairs = (digits * _U[10] + (digits >> _U[8])) & _PAIRS
    fours = (pairs * np.uint64(100) + (pairs >> _U[16])) & _FOURS
    return (fours * np.uint64(10000) + (fours >> _U[32])) & _EIGHT
