# SPDX-License-Identifier: BSD-3-Clause
"""What all logs have in common: scans in order, their selection, and clear errors."""
