# SPDX-License-Identifier: BSD-3-Clause
"""Maps of any kind: opened, made by the name of their kind, and written for other programs."""
