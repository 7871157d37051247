# SPDX-License-Identifier: BSD-3-Clause
"""Several logs mapped with several sets of parameters: side by side, over processes, and not twice."""

from ndtree.study.config import Study, load
from ndtree.study.results import StudyTable
from ndtree.study.run import run

__all__ = ["Study", "StudyTable", "load", "run"]
