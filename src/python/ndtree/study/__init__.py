# SPDX-License-Identifier: BSD-3-Clause
"""Several logs mapped with several sets of parameters: side by side, over processes, and not twice."""

from ndtree.study.config import Study, load
from ndtree.study.run import run
from ndtree.study.table import StudyTable

__all__ = ["Study", "StudyTable", "load", "run"]
