# SPDX-License-Identifier: BSD-3-Clause
"""Mapping by many processes: those of this machine, or of an engine that is there already: Ray or Dask."""

from ndtree.distributed.engines import Engine
from ndtree.distributed.fleet import map, remap
from ndtree.distributed.report import FleetReport
from ndtree.distributed.scans import moved
from ndtree.distributed.stages import BlockRecord, FleetSettings

__all__ = ["BlockRecord", "Engine", "FleetReport", "FleetSettings", "map", "moved", "remap"]
