# SPDX-License-Identifier: BSD-3-Clause
"""Which options the kinds of maps take. Their defaults are the maps' own and stand nowhere here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ndtree._native import _core
from ndtree._native._core import OccupancyMap


@dataclass(frozen=True)
class MapOption:
    """A keyword of the maps' constructors, and a flag of the command line."""

    name: str
    type: type
    help: str


MAP_OPTIONS = (
    MapOption("branching", int, "Children of a node along each axis, N."),
    MapOption("min_cell_size", float, "Edge of the smallest cells [m]; of all cells where they are fixed."),
    MapOption("max_cell_size", float, "Edge of the largest cells that are updated [m]."),
    MapOption("refinement", str, "Policy that splits and merges cells."),
    MapOption("range_sigma", float, "Standard deviation of a range [m]."),
    MapOption("range_sigma_quadratic", float, "Its growth with the squared range [1/m]."),
    MapOption("probability_min", float, "Least probability that one beam gives a cell."),
    MapOption("probability_max", float, "Largest probability that one beam gives a cell."),
    MapOption("log_odds_min", float, "A cell's log-odds never fall below."),
    MapOption("log_odds_max", float, "A cell's log-odds never rise above."),
    MapOption("miss_given_occupied", float, "Fraction of beams that pass an occupied cell."),
    MapOption("hit_given_free", float, "Fraction of beams that end in a free cell."),
    MapOption(
        "split_probability",
        float,
        "An occupied cell splits if more probably than this it is partially occupied.",
    ),
    MapOption("merge_loss", float, "Siblings merge if that loses at most this per cell saved [bits]."),
    MapOption("inherited_beams", float, "Evenly spread beams added where a split divides evidence."),
    MapOption(
        "noise_sigmas", float, "No hit or miss splits cells into children smaller than this many sigma."
    ),
    MapOption("evidence_memory", float, "Evidence that a cell remembers [nats]."),
    MapOption("free_memory", float, "Evidence that a cell remembers if it is for free space only [nats]."),
    MapOption("scan_beams", float, "Beams of a scan that count at most in a cell if all passed it."),
    MapOption(
        "known_evidence", float, "A cell with this evidence is well observed, and samples fewer beams [nats]."
    ),
    MapOption(
        "sample_beams",
        float,
        "Beams of a dense scan that a cell samples, per smallest cell side by side in it.",
    ),
    MapOption("evidence_prior", float, "Evidence that a cell begins with [nats]."),
    MapOption("change_probability", float, "A streak of scans less likely is a change; 0: never."),
    MapOption("evidence_half_life", float, "A cell's evidence halves in this many of its scans; 0: never."),
    MapOption(
        "covered_share",
        float,
        "Fraction of each part (quadrant, octant) to be seen until a cell is observed; 0: any beam.",
    ),
    MapOption(
        "coverage_cells",
        float,
        "Cells with an edge of more smallest cells than this split to show what was seen.",
    ),
    MapOption(
        "partial_probability",
        float,
        "Least probability of a smallest cell that holds something thin; 0: all its beams decide.",
    ),
    MapOption("beam_divergence", float, "Full angle of wide beams, as of sonar [rad]; 0: lines."),
    MapOption("max_memory", float, "No map holds more [bytes]; 0: 3/4 of the machine's memory."),
    MapOption("significance", float, "Confidence of the split test."),
    MapOption("merge_free_below", float, "Siblings merge if all are at most this probable."),
    MapOption("merge_occupied_above", float, "Siblings merge if all are at least this probable."),
)
OPTION_NAMES = tuple(option.name for option in MAP_OPTIONS)

DEFAULT_REFINEMENT = _core.AdaptiveMap(dim=2).refinement

_INSERTIONS = {
    "octomap": "ray",
    "octomap-scan": "scan",
    "octomap-scan-lazy": "scan_lazy",
    "octomap-scan-discretized": "scan_discretized",
}

#: What a comparison can have in it; "paper" is the adaptive map exactly as the paper has it, "octomap-scan"
#: inserts scans by ``insertPointCloud``, which updates each cell once a scan, "-lazy" without pruning,
#: "-discretized" also with one beam for each cell that beams end in.
KINDS = ("adaptive", "paper", "fixed", *_INSERTIONS)


def make_map(name: str, *, dim: int, cell_size: float | None = None, **options: Any) -> OccupancyMap:
    """A map by the name of its kind; of the options it gets those that it takes.

    Parameters
    ----------
    name : str
        One of `KINDS`, with "@" and a cell size [m] if that is not the common one, as in "fixed@0.1".
    dim : int
        Number of coordinates of a point.
    cell_size : float, optional
        The common cell size [m], ``min_cell_size`` of an adaptive map. Left out: the adaptive map's default.
    **options
        As in `AdaptiveMap`.

    Raises
    ------
    ValueError
        If there is no such kind, or an option is out of its limits.
    RuntimeError
        If OctoMap was not there when the module was built.
    """
    kind, _, own_size = name.partition("@")
    if kind not in KINDS:
        raise ValueError(f"map {name!r}: must be one of {', '.join(KINDS)}, with @ and a cell size if wanted")
    if own_size:
        try:
            cell_size = float(own_size)
        except ValueError:
            raise ValueError(f"map {name!r}: expected a cell size in metres behind the @") from None
    for option in options:
        if option not in OPTION_NAMES or option == "min_cell_size":
            raise TypeError(f"{option}: no map has such an option")
    if kind in ("adaptive", "paper"):
        if kind == "paper":
            options["refinement"] = "paper"
        if cell_size is not None:
            options["min_cell_size"] = cell_size
        plain = _core.AdaptiveMap(dim=dim, refinement=options.get("refinement", DEFAULT_REFINEMENT))
        return _core.AdaptiveMap(dim=dim, **_only({"branching", "refinement", *plain.options}, options))
    if cell_size is None:
        cell_size = _core.default_options()["min_cell_size"]
    if kind == "fixed":
        taken = {"branching", *_core.FixedMap(dim=dim).options}
        return _core.FixedMap(dim=dim, cell_size=cell_size, **_only(taken, options))
    if not _core.has_octomap:
        raise RuntimeError(f"map {name!r}: OctoMap was not there when ndtree was built")
    taken = set(_core.OctoMap(dim=dim).options)
    return _core.OctoMap(dim=dim, cell_size=cell_size, insertion=_INSERTIONS[kind], **_only(taken, options))


def _only(names: set[str], options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if name in names}
