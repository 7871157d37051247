# SPDX-License-Identifier: BSD-3-Clause
"""What structure from motion leaves: cameras, points, and which saw which."""
