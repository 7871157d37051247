# SPDX-License-Identifier: BSD-3-Clause
"""Mapping on many machines, by an engine that is there already: Ray, Dask, or threads of this process."""

from ndtree.distributed.engines import Engine
from ndtree.distributed.fleet import FleetReport, map, remap
from ndtree.distributed.scans import moved
from ndtree.distributed.stages import BlockRecord

__all__ = ["BlockRecord", "Engine", "FleetReport", "map", "moved", "remap"]
