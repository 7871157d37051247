# SPDX-License-Identifier: BSD-3-Clause
"""Leaves on a grid of integers, their neighbours, and what of a map is worth showing."""
