# SPDX-License-Identifier: BSD-3-Clause
"""Small mistakes in Python files and headers, drawn at random: for tools/mutate --draw.

A comparison is turned around, a sign swapped, a term or a condition dropped, "and" and "or" are exchanged, a
branch is never taken. What is raised, formatted as text or an annotation stays as it is: tests do not ask
about it.
"""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterator

#: By the name of a file below src/python/ndtree: the tests that have to notice its mistakes.
TESTS = {
    "alignment/aligning.py": "test_align.py",
    "alignment/loops.py": "test_align.py",
    "alignment/motion.py": "test_align.py",
    "alignment/planar.py": "test_align.py",
    "alignment/stalls.py": "test_align.py",
    "alignment/tracking.py": "test_align.py",
    "evaluation/delayed.py": "test_moved.py",
    "evaluation/exact_truth.py": "test_exact_truth.py",
    "evaluation/map_comparison/blocks.py": "test_compare_maps.py",
    "evaluation/map_comparison/run.py": "test_compare_maps.py",
    "evaluation/moved.py": "test_moved.py",
    "live/corrections.py": "test_live_corrections.py",
    "live/fading.py": "test_live_fading.py",
    "live/grid.py": "test_live_grid.py",
    "live/localizing.py": "test_live_localizing.py",
    "live/passing.py": "test_live_passing.py",
    "live/routing.py": "test_live_routing.py",
    "logs/core/silence.py": "test_silence.py",
    "logs/folders/coordinate_system.py": "test_coordinate_systems.py",
    "logs/folders/point_clouds.py": "test_point_clouds.py test_readers.py test_text_clouds.py",
    "tuning/first_look.py": "test_no_returns.py test_scale.py",
    "tuning/range_end.py": "test_range_end.py",
    "tuning/heading.py": "test_heading.py",
    "tuning/mismatch.py": "test_carried.py test_mismatch.py",
    "tuning/revisits.py": "test_revisits.py",
    "tuning/setup_error.py": "test_setup_error.py test_setup_in_space.py",
    "tuning/setup.py": "test_setup_error.py test_setup_in_space.py",
}
_TURNED = {ast.Lt: ">", ast.Gt: "<", ast.LtE: ">=", ast.GtE: "<=", ast.Eq: "!=", ast.NotEq: "=="}
_SWAPPED = {ast.Add: "-", ast.Sub: "+"}
#: By the name of a header below include/ndtree: the test that has to notice its mistakes.
HEADERS = {
    "alignment/matcher.hpp": "test_matcher.cpp",
    "alignment/scan_pieces.hpp": "test_matcher.cpp",
    "alignment/pose_graph.hpp": "test_pose_graph.cpp",
    "evaluation/calibration.hpp": "test_calibration.cpp",
    "evaluation/held_out_truth.hpp": "test_held_out_truth.cpp",
    "evaluation/no_returns.hpp": "test_no_returns.cpp",
    "mapping/edit/compress.hpp": "test_compress.cpp",
    "mapping/edit/join.hpp": "test_join.cpp",
    "mapping/edit/mark.hpp": "test_marks.cpp",
    "mapping/history/scan_history.hpp": "test_scan_history.cpp",
    "mapping/insert/coverage.hpp": "test_scan_update.cpp",
    "mapping/insert/leaf_action.hpp": "test_leaf_action.cpp",
    "mapping/insert/pose_covariance.hpp": "test_pose_covariance.cpp",
    "query/collision.hpp": "test_planning_queries.cpp",
    "query/distance_transform.hpp": "test_point_packet.cpp",
    "query/field_update.hpp": "test_field_update.cpp",
    "query/information_gain.hpp": "test_information_gain.cpp",
    "query/nearest.hpp": "test_planning_queries.cpp",
    "query/point_packet.hpp": "test_point_packet.cpp",
    "query/ray.hpp": "test_queries.cpp",
    "query/transform.hpp": "test_transform.cpp",
}
#: Binary operators of a formatted header, and what they become.
_OPERATORS = {" < ": " > ", " > ": " < ", " <= ": " >= ", " >= ": " <= ", " == ": " != ", " != ": " == ",
              " + ": " - ", " - ": " + ", " && ": " || ", " || ": " && "}  # fmt: skip
_UNTESTED = re.compile(r"^\s*(#|//|template|static_assert|assert|throw)|throw std::|requires ")


def drawn(source: str, count: int, seed: int) -> list[tuple[str, str]]:
    """At most `count` mistakes: lines of a source that it has once, and what they become."""
    found = list(_mistakes(source))
    random.Random(seed).shuffle(found)
    lines = source.splitlines(keepends=True)
    chosen: list[tuple[str, str]] = []
    for node, wrong in found:
        first, last = node.lineno - 1, node.end_lineno
        old = "".join(lines[first:last])
        begin = len(lines[first].encode()[: node.col_offset].decode())
        end = len(old) - len(lines[last - 1]) + len(lines[last - 1].encode()[: node.end_col_offset].decode())
        new = old[:begin] + wrong + old[end:]
        if source.count(old) == 1 and _is_python(source.replace(old, new)):
            chosen.append((old, new))
        if len(chosen) == count:
            break
    return chosen


def drawn_in_header(source: str, count: int, seed: int) -> list[tuple[str, str]]:
    """At most `count` mistakes in a header: one operator of a line that it has once, turned around."""
    found = []
    for line in source.splitlines(keepends=True):
        code = line.split("//")[0]
        if _UNTESTED.search(code) or '"' in code or source.count(line) != 1:
            continue
        for old, new in _OPERATORS.items():
            places = [one.start() for one in re.finditer(re.escape(old), code)]
            found += [(line, line[:at] + new + line[at + len(old) :]) for at in places]
    random.Random(seed).shuffle(found)
    return found[:count]


def _mistakes(source: str) -> Iterator[tuple[ast.expr, str]]:
    """Expressions, and what may stand in their place."""
    tree = ast.parse(source)
    left_out = {id(below) for node in ast.walk(tree) for part in _untested(node) for below in ast.walk(part)}

    def text(node: ast.expr) -> str:
        return f"({ast.get_source_segment(source, node)})"

    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _TURNED:
            yield node, f"{text(node.left)} {_TURNED[type(node.ops[0])]} {text(node.comparators[0])}"
        elif isinstance(node, ast.BinOp) and type(node.op) in _SWAPPED:
            yield node, f"({text(node.left)} {_SWAPPED[type(node.op)]} {text(node.right)})"
            yield node, text(node.left)
        elif isinstance(node, ast.BoolOp):
            other = " or " if isinstance(node.op, ast.And) else " and "
            yield node, f"({other.join(map(text, node.values))})"
            yield node, text(node.values[0])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield node, text(node.operand)
        elif isinstance(node, ast.If):
            yield node.test, "(False)"


def _untested(node: ast.AST) -> Iterator[ast.AST]:
    """What of a node no test asks about."""
    if isinstance(node, (ast.Raise, ast.JoinedStr)):
        yield node
    if isinstance(node, ast.AnnAssign):
        yield node.annotation
    if isinstance(node, (ast.FunctionDef, ast.arg)):
        annotation = node.returns if isinstance(node, ast.FunctionDef) else node.annotation
        if annotation is not None:
            yield annotation


def _is_python(source: str) -> bool:
    try:
        compile(source, "", "exec")
    except SyntaxError:
        return False
    return True
