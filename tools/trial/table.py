# SPDX-License-Identifier: BSD-3-Clause
"""How often answers were right, doubted, refused and silently wrong: by capability, world and fault."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from trial.capabilities import Trial
from trial.outcome import VERDICTS, WRONG

#: Silently wrong of 1,000 trials of a capability, at most, and trials of one row; doubted of 100 right ones.
MOST_WRONG, MOST_WRONG_IN_A_ROW, MOST_NEEDLESS = 2, 1, 5


@dataclass(frozen=True)
class Done:
    """A trial that was run: what a table keeps of it."""

    trial: Trial
    verdict: str
    is_needless: bool
    line: str
    seconds: float


def table_of(done: Iterable[Done]) -> dict[str, Any]:
    """Counts of VERDICTS by capability, world and fault, and a line for each that is silently wrong."""
    table: dict[str, Any] = {}
    for one in done:
        entry = table.setdefault(
            one.trial.capability,
            {
                "trials": 0,
                "counts": _zeros(),
                "needless": 0,
                "seconds_each": 0.0,
                "worlds": {},
                "faults": {},
                "wrong": [],
            },
        )
        at = VERDICTS.index(one.verdict)
        entry["trials"] += 1
        entry["needless"] += one.is_needless
        entry["seconds_each"] += one.seconds
        for counts in (
            entry["counts"],
            entry["worlds"].setdefault(one.trial.world, _zeros()),
            entry["faults"].setdefault(one.trial.fault, _zeros()),
        ):
            counts[at] += 1
        if one.verdict == WRONG:
            entry["wrong"].append(one.line)
    for entry in table.values():
        entry["seconds_each"] = round(entry["seconds_each"] / entry["trials"], 2)
    return table


def _zeros() -> list[int]:
    return [0] * len(VERDICTS)


def new_in(table: dict[str, Any], before: dict[str, Any]) -> list[str]:
    """Lines of trials that are silently wrong, and were run before and were not."""
    known = {line.split(": ")[0] for entry in before.values() for line in entry["wrong"]}
    lines = [(name, line) for name, entry in table.items() for line in entry["wrong"]]
    return [
        line
        for name, line in lines
        if line.split(": ")[0] not in known
        and int(line.split(": ")[0].rsplit(" ", 1)[1]) < before.get(name, {}).get("trials", 0)
    ]


def beyond(table: dict[str, Any]) -> list[str]:
    """Of each capability that misses a bound, by how much it does."""
    lines = []
    for name, entry in table.items():
        right, _, _, wrong = entry["counts"]
        in_a_row = max(counts[-1] for kind in ("worlds", "faults") for counts in entry[kind].values())
        if 1000 * wrong > MOST_WRONG * entry["trials"] or in_a_row > MOST_WRONG_IN_A_ROW:
            lines.append(f"{name}: {wrong} of {entry['trials']} silently wrong, {in_a_row} in one row")
        if 100 * entry["needless"] > MOST_NEEDLESS * max(1, right + entry["needless"]):
            lines.append(f"{name}: {entry['needless']} of {right + entry['needless']} right ones doubted")
    return lines


def lines_of(table: dict[str, Any], before: dict[str, Any]) -> list[str]:
    """A line for each row, with the difference of the silently wrong share to a table before [points]."""
    head = (
        f"{'':10} {'':14} {'trials':>6}" + "".join(f"{one:>9}" for one in (*VERDICTS, "needless")) + "  wrong"
    )
    lines = [head]
    for name, entry in table.items():
        was = before.get(name, {})
        lines.append(_line(name, "", entry["counts"], was.get("counts"), entry["needless"]))
        for kind in ("worlds", "faults"):
            for row, counts in entry[kind].items():
                lines.append(_line("", row, counts, was.get(kind, {}).get(row)))
    return lines


def _line(name: str, row: str, counts: list[int], was: list[int] | None, needless: int | None = None) -> str:
    now = 100 * counts[-1] / sum(counts)
    text = f"{name:10} {row:14} {sum(counts):6}" + "".join(f"{one:9}" for one in counts)
    text += f"{'' if needless is None else needless:>9}  {now:.1f} %"
    if was is not None and sum(was) and abs(now - 100 * was[-1] / sum(was)) > 0.05:
        text += f" ({now - 100 * was[-1] / sum(was):+.1f})"
    return text
