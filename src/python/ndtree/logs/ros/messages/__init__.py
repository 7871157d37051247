# SPDX-License-Identifier: BSD-3-Clause
"""Messages of sensors as beams."""
