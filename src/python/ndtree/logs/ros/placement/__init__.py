# SPDX-License-Identifier: BSD-3-Clause
"""Where a sensor was when it measured."""
