# SPDX-License-Identifier: BSD-3-Clause
"""Logs that are folders: point clouds or depth images, and a file of poses."""
