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
ChangeOf = Literal["states", "columns", "cells"]
World = Literal["office", "apartment", "street"]


class OctoMapOptions(TypedDict, total=False):
    """Keywords of `ndtree.OctoMap`."""

    min_cell_size: float
    probability_min: float
    probability_max: float
    log_odds_min: float
    log_odds_max: float


class FixedMapOptions(TypedDict, total=False):
    """Keywords of `ndtree.FixedMap`."""

    min_cell_size: float
    range_sigma: float
    range_sigma_quadratic: float
    probability_min: float
    probability_max: float
    log_odds_min: float
    log_odds_max: float
    max_memory: float


class MapOptions(TypedDict, total=False):
    """Keywords of `ndtree.AdaptiveMap`, and what `OccupancyMap.options` and `default_options` give."""

    min_cell_size: float
    max_cell_size: float
    range_sigma: float
    range_sigma_quadratic: float
    probability_min: float
    probability_max: float
    log_odds_min: float
    log_odds_max: float
    miss_given_occupied: float
    hit_given_free: float
    significance: float
    sample_beams: float
    evidence_half_life: float
    covered_share: float
    beam_divergence: float
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
