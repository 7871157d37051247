# SPDX-License-Identifier: BSD-3-Clause
"""Numbers in blocks of text: the same doubles as `float` makes of each field, or none."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from ndtree.logs.folders import text_clouds
from ndtree.logs.folders.text_clouds import text_points

hypothesis = pytest.importorskip("hypothesis")
st = hypothesis.strategies

digits = st.text("0123456789", min_size=1, max_size=18)
plain = st.builds(
    lambda sign, whole, point, rest: f"{sign}{whole}{point}{rest}",
    st.sampled_from(["", "-", "+"]), digits, st.sampled_from(["", "."]), digits,
)  # fmt: skip
others = ("nan", "inf", "-1e-7", "1e400", "4.9e-324", "-0.0", "+.5", "5.", "9999999999999999")


def same(found: np.ndarray, expected: list[float]) -> None:
    np.testing.assert_array_equal(found.view(np.uint64), np.array(expected).view(np.uint64))


@hypothesis.settings(max_examples=200, deadline=None)
@hypothesis.given(
    field=st.one_of(plain, st.sampled_from(others)), between=st.sampled_from([" ", ";", "\t", ", "]),
    column=st.integers(0, 2), end=st.sampled_from(["\n", "\r\n"]), row=st.integers(60, 99),
)  # fmt: skip
def test_a_field_is_what_float_makes_of_it(field: str, between: str, column: int, end: str, row: int) -> None:
    rows = [["12.5", "-3", "0.125"] for _ in range(100)]
    rows[row][column] = field
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.xyz"
        path.write_bytes("".join(between.join(fields) + end for fields in rows).encode())
        same(text_points(str(path)).ravel(), [float(one) for fields in rows for one in fields])


def test_random_numbers_of_any_length_are_exact(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for places in range(16):
        values = np.concatenate([rng.normal(scale=scale, size=3000) for scale in (1e-3, 1.0, 1e4, 1e7)])
        texts = [f"{value:.{places}f}" for value in values]
        lines = (f"{a} {b} {c}\n" for a, b, c in zip(texts[::3], texts[1::3], texts[2::3]))
        (tmp_path / "a.xyz").write_text("".join(lines))
        same(text_points(str(tmp_path / "a.xyz")).ravel(), [float(text) for text in texts])


def test_points_of_any_block_are_those_of_its_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks that are parsed at once, and such that have blank lines, words or long numbers in them."""
    monkeypatch.setattr(text_clouds, "_BLOCK", 50)
    rng = np.random.default_rng(4)
    rows = rng.normal(scale=30, size=(4000, 3))
    forms = [
        "{:.4f} {:.2f} {:.3f}",
        "{!r} {!r} {!r}",
        "{:.3e} {:g} {:.1f} wall",
        "\n{:.4f}\t{:.2f} {:.3f} 5 6",
    ]
    lines, expected = [], []
    for i, row in enumerate(rows.tolist()):
        line = forms[i // 300 % 4].format(*row)
        lines.append(line)
        expected += [float(field) for field in line.split()[:3]]
    (tmp_path / "a.xyz").write_text("\n".join(lines))
    same(text_points(str(tmp_path / "a.xyz")).ravel(), expected)
