# SPDX-License-Identifier: BSD-3-Clause
"""Logs that are one file of scans, and simulated ones."""
