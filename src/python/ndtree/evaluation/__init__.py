# SPDX-License-Identifier: BSD-3-Clause
"""How true maps are, alone, beside each other, and what beams without return mean."""
