# SPDX-License-Identifier: BSD-3-Clause
"""How the command ``ndtree`` ends."""

DONE = 0
BAD_INPUT = 1
WRONG_CALL = 2


class WrongCall(Exception):
    """What the user asked for cannot be done, whatever the input."""
