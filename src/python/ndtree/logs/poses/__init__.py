# SPDX-License-Identifier: BSD-3-Clause
"""Poses, trajectories and the files that hold them."""
