# SPDX-License-Identifier: BSD-3-Clause
"""How the command ``ndtree`` ends."""

DONE = 0
BAD_INPUT = 1
WRONG_CALL = 2
#: By Ctrl-C: 128 and the number of the signal, as shells have it.
INTERRUPTED = 130


class WrongCall(Exception):
    """What the user asked for cannot be done, whatever the input."""
