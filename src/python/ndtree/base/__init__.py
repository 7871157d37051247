# SPDX-License-Identifier: BSD-3-Clause
"""What every folder above uses: scans, files that appear whole, exit statuses, types."""
