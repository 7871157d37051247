# SPDX-License-Identifier: BSD-3-Clause
"""``python -m ndtree``: the command ``ndtree`` of this interpreter."""

from ndtree.cli import main

main()
