# SPDX-License-Identifier: BSD-3-Clause
"""Types for annotations: the words that calls take, and their options as dictionaries.

>>> from ndtree.typing import MapOptions
>>> options: MapOptions = {"min_cell_size": 0.1, "range_sigma": 0.02}
>>> m = ndtree.AdaptiveMap(dim=3, **options)
"""

from __future__ import annotations

from typing import Literal, TypedDict

__all__ = [
    "ChangeOf",
    "FixedMapOptions",
    "Insertion",
    "MapOptions",
    "OctoMapOptions",
    "Refinement",
    "SimulationOptions",
    "StateName",
    "UnknownAs",
    "World",
]

Refinement = Literal["evidence", "paper"]
Insertion = Literal["ray", "scan", "scan_lazy", "scan_discretized"]
StateName = Literal["free", "occupied", "unknown"]
#: What unknown space is taken for.
UnknownAs = Literal["free", "occupied"]
#: What counts as a change: another state, or anything that a cell holds.
ChangeOf = Literal["states", "cells"]
World = Literal["office", "apartment", "street"]


class _CommonOptions(TypedDict, total=False):
    probability_min: float
    probability_max: float
    log_odds_min: float
    log_odds_max: float


class OctoMapOptions(_CommonOptions, total=False):
    """Keywords of `ndtree.OctoMap`."""

    cell_size: float


class FixedMapOptions(_CommonOptions, total=False):
    """Keywords of `ndtree.FixedMap`."""

    cell_size: float
    range_sigma: float
    range_sigma_quadratic: float
    max_memory: float


class MapOptions(_CommonOptions, total=False):
    """Keywords of `ndtree.AdaptiveMap`, and what `OccupancyMap.options` and `default_options` give."""

    min_cell_size: float
    max_cell_size: float
    range_sigma: float
    range_sigma_quadratic: float
    miss_given_occupied: float
    hit_given_free: float
    split_probability: float
    merge_loss: float
    inherited_beams: float
    noise_sigmas: float
    evidence_memory: float
    free_memory: float
    scan_beams: float
    known_evidence: float
    sample_beams: float
    evidence_prior: float
    change_probability: float
    evidence_half_life: float
    covered_share: float
    coverage_cells: float
    partial_probability: float
    beam_divergence: float
    significance: float
    merge_free_below: float
    merge_occupied_above: float
    max_memory: float


class SimulationOptions(TypedDict, total=False):
    """Keywords of `ndtree.simulate`."""

    noise_scale: float
    outlier_rate: float
    no_return_rate: float
    position_sigma: float
    heading_sigma: float
    yaw: float
    people: int
    doors: int
    cars: int
