# SPDX-License-Identifier: BSD-3-Clause
"""Random worlds, robots and faults with exact truth, and judges of what the library says of them."""
