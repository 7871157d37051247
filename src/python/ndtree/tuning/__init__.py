# SPDX-License-Identifier: BSD-3-Clause
"""Options that suit a log: its sensor's noise and rates, its scale, and whether its poses fit."""
