# SPDX-License-Identifier: BSD-3-Clause
"""The sensor's parameters, estimated from a log: noise by flat surfaces, error rates by scans held out."""

from ndtree.tuning.calibration.estimation import calibrate, range_noise
from ndtree.tuning.calibration.figures import Calibration, Estimate

__all__ = ["Calibration", "Estimate", "calibrate", "range_noise"]
