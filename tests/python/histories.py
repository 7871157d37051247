# SPDX-License-Identifier: BSD-3-Clause
"""What histories of scans are compared with."""

import ndtree


def mapped_anew(history: ndtree.ScanHistory, numbers: dict[int, int], **options: float) -> ndtree.AdaptiveMap:
    """A map of the present scans at their present poses, with what they measured."""
    m = ndtree.AdaptiveMap(dim=history.dim, layers=history.layers, **options)
    for key in history.keys():
        scan = history.scan(key)
        m.insert(
            scan.endpoints, scan.origin, returned=scan.returned, range_sigma=scan.range_sigma,
            number=numbers[key], layers=history.measurements(key),
        )  # fmt: skip
    return m
