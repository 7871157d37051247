# SPDX-License-Identifier: BSD-3-Clause
"""All beams of one sensor reading: the Python twin of ``ndtree::Scan``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ndtree._native._arguments import refuse_masked
from ndtree._native._checked import checked
from ndtree._native._kinds import shown
from ndtree.base.voxels import voxelise

if TYPE_CHECKING:
    from ndtree._native._core import HeldOutTruth, InsertReport, OccupancyMap

#: The layer with colours, red, green and blue from 0 to 255, and its rule.
COLOR, COLOR_RULE = "color", "mean3"


@checked
@dataclass(frozen=True, eq=False)
class Scan:
    """One sensor reading in the map frame.

    Parameters
    ----------
    endpoints : array_like, (n, dim)
        Measured points [m]. A beam whose end point is not finite says nothing; maps count it as invalid.
    origin : array_like, (dim,) or (n, dim)
        Position of the sensor [m], one for all beams or one for each.
    returned : array_like of bool, (n,), optional
        False where nothing was hit up to the end point. Left out: every beam hit a surface.
    stamp : float
        Time of the reading [s]; 0 where the log has none.
    range_sigma : array_like, (n,), optional
        Standard deviation of each beam's range [m]. Left out: the map's own, from its options.
    points_only : bool
        There is no sensor: the smallest cells that hold an end point become occupied, nothing becomes free,
        and `origin` is not looked at.
    heading : float, optional
        Direction of the sensor in the plane, its yaw [rad], where a 2-D log says it; maps do not need it.
    pose_covariance : array_like, (3, 3) or (6, 6), optional
        How sure the sensor's pose is, as of ``insert`` of a map.
    layers : mapping of str to array_like, optional
        What beams measured beside their range, one entry each, as colours: for the map's layer of that name.
    rotation : array_like, (3, 3), optional
        Of the sensor in space, from its own axes to the map's, where a 3-D log says it; maps do not need it.
    by_depth : bool
        The sensor measures how far points are along its z axis, as depth cameras do; maps do not need it.

    Raises
    ------
    ValueError
        If the shapes do not fit together, both are named; or if a `range_sigma` is not above 0 and finite, or
        the `pose_covariance` is none.
    """

    endpoints: NDArray[np.floating[Any]]
    origin: NDArray[np.floating[Any]]
    returned: NDArray[np.bool_] | None = None
    stamp: float = 0.0
    range_sigma: NDArray[np.floating[Any]] | None = None
    points_only: bool = False
    heading: float | None = None
    pose_covariance: NDArray[np.float64] | None = None
    layers: Mapping[str, NDArray[Any]] | None = None
    rotation: NDArray[np.float64] | None = None
    by_depth: bool = False

    def __post_init__(self) -> None:
        refuse_masked("Scan", vars(self))
        endpoints = _floats(self.endpoints)
        origin = _floats(self.origin)
        if endpoints.ndim != 2 or endpoints.shape[1] < 1:
            raise ValueError(f"endpoints has shape {endpoints.shape}: must be (n, dim)")
        n, dim = endpoints.shape
        if origin.shape not in ((dim,), (n, dim)):
            raise ValueError(
                f"origin has shape {origin.shape}: "
                f"must be ({dim},) or ({n}, {dim}) for endpoints of shape ({n}, {dim})"
            )
        object.__setattr__(self, "endpoints", endpoints)
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "stamp", float(self.stamp))
        if self.heading is not None:
            object.__setattr__(self, "heading", float(self.heading))
        if not isinstance(self.points_only, (bool, np.bool_)):
            raise TypeError(f"Scan(): points_only = {shown(self.points_only)}: must be True or False")
        if self.returned is not None:
            returned = np.asarray(self.returned)
            if returned.dtype != np.bool_:
                raise ValueError(f"returned has dtype {returned.dtype}: must be bool")
            self._set_of_each_beam("returned", returned)
        if self.range_sigma is not None:
            range_sigma = _floats(self.range_sigma)
            self._set_of_each_beam("range_sigma", range_sigma)
            wrong = np.flatnonzero(~((range_sigma > 0) & np.isfinite(range_sigma)))
            if wrong.size:
                raise ValueError(
                    f"range_sigma = {range_sigma[wrong[0]]:g} m of beam {wrong[0]}: must be > 0 and finite"
                )
        if self.pose_covariance is not None:
            covariance = np.asarray(self.pose_covariance, dtype=np.float64)
            require_covariance(covariance, dim)
            object.__setattr__(self, "pose_covariance", covariance)
        if self.rotation is not None and np.shape(self.rotation) != (3, 3):
            raise ValueError(f"rotation has shape {np.shape(self.rotation)}: must be (3, 3)")
        for name, values in (self.layers or {}).items():
            if len(values) != n:
                raise ValueError(f"layers: {name} has shape {np.shape(values)}: must be ({n}, ...)")

    def _set_of_each_beam(self, name: str, values: NDArray[Any]) -> None:
        n, dim = self.endpoints.shape
        if values.shape != (n,):
            raise ValueError(
                f"{name} has shape {values.shape}: must be ({n},) for endpoints of shape ({n}, {dim})"
            )
        object.__setattr__(self, name, values)

    def __len__(self) -> int:
        """Number of beams."""
        return self.endpoints.shape[0]

    def __bool__(self) -> bool:
        """True, also for a scan without beams."""
        return True

    def __repr__(self) -> str:
        silent = np.count_nonzero(~self.did_return)
        return f"Scan({len(self)} beams in {self.dim}-D, {silent} not returned, stamp={self.stamp!r})"

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.endpoints.shape[1]

    @property
    def did_return(self) -> NDArray[np.bool_]:
        """(n,) bool: `returned`; all True where that was left out."""
        return np.ones(len(self), dtype=bool) if self.returned is None else self.returned

    def hits(self, max_range: float = math.inf) -> NDArray[np.bool_]:
        """(n,) bool: which beams met a surface within `max_range` [m]; those of no length met none."""
        length = np.linalg.norm(self.endpoints - self.origin, axis=1)
        return self.did_return & np.isfinite(length) & (length > 0) & (length <= max_range)

    def require_sensor(self, what: str) -> None:
        """Refuse points without a sensor for something that needs beams.

        Raises
        ------
        ValueError
            If there is no sensor; it names `what` needs one.
        """
        if self.points_only:
            raise ValueError(f"points without a sensor have no beams, and {what} need some")

    def returned_only(self) -> Scan:
        """The same scan with only the beams that returned, in their order.

        For sensors whose missing returns say nothing: glass, dark surfaces and the sky cause them alike.
        """
        if self.returned is None:
            return self
        return replace(self, returned=None) if self.returned.all() else self._part(self.returned, None)

    def only(self, which: NDArray[np.bool_] | slice) -> Scan:
        """The same scan with only some beams, in their order.

        Parameters
        ----------
        which : ndarray of bool, (n,), or slice
        """
        return self._part(which, None if self.returned is None else self.returned[which])

    def _part(self, which: NDArray[np.bool_] | slice, returned: NDArray[np.bool_] | None) -> Scan:
        def part(values: NDArray[Any] | None) -> Any:
            return None if values is None else values[which]

        return Scan(
            self.endpoints[which],
            self.origin if self.origin.ndim == 1 else self.origin[which],
            returned,
            self.stamp,
            part(self.range_sigma),
            self.points_only,
            self.heading,
            self.pose_covariance,
            None if self.layers is None else {name: values[which] for name, values in self.layers.items()},
            self.rotation,
            self.by_depth,
        )

    def with_sigma(self, options: Mapping[str, float]) -> Scan:
        """The same scan for a map of these options, with `range_sigma` instead of a `pose_covariance`.

        Parameters
        ----------
        options : mapping of str to float
            Of the map; ``range_sigma`` and ``range_sigma_quadratic`` count.

        Returns
        -------
        Scan
            Itself, if it has no covariance.
        """
        if self.pose_covariance is None:
            return self
        from ndtree._native import _core

        noise = {name: options[name] for name in ("range_sigma", "range_sigma_quadratic") if name in options}
        sigma = _core.pose_range_sigma(
            self.endpoints, self.origin, self.pose_covariance, own=self.range_sigma, **noise
        )
        return replace(self, range_sigma=sigma, pose_covariance=None)

    def returned_beams(
        self, max_range: float = math.inf
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Beams that met a surface within `max_range`: those of which a map can be asked whether it is there.

        Parameters
        ----------
        max_range : float
            Beams that are longer are left out [m].

        Returns
        -------
        starts : (n, dim) float64
            Where the beams come from [m].
        directions : (n, dim) float64
            Unit vectors.
        ranges : (n,) float64
            Their lengths [m].
        """
        use = self.did_return & np.isfinite(self.endpoints).all(axis=1)
        start = np.broadcast_to(self.origin, self.endpoints.shape)[use].astype(np.float64)
        way = self.endpoints[use] - start
        length = np.linalg.norm(way, axis=1)
        use = (length > 0) & (length <= max_range)
        return start[use], way[use] / length[use, None], length[use]

    def insert_into(
        self, target: OccupancyMap, *, max_range: float = math.inf, threads: int = 0, **more: Any
    ) -> InsertReport:
        """Integrate the scan into a map; the same as the map's own ``insert``.

        Parameters
        ----------
        target : AdaptiveMap, FixedMap or OctoMap
            Of the same ``dim`` as the scan.
        max_range : float
            Longer beams are free up to there and have no end point [m].
        threads : int
            As for ``insert``; 0: all cores.
        **more
            As for ``insert``: ``moved``, ``window``, ``number``.

        Returns
        -------
        InsertReport
            What became of the beams.
        """
        if self.points_only:
            return voxelise(self.endpoints, target)
        if self.range_sigma is not None:
            more["range_sigma"] = self.range_sigma
        if self.pose_covariance is not None:
            more["pose_covariance"] = self.pose_covariance
        if self.layers:
            has = target.layers
            more["layers"] = {name: values for name, values in self.layers.items() if name in has}
        return target.insert(
            self.endpoints, self.origin, returned=self.returned, max_range=max_range, threads=threads, **more
        )

    def evaluate_on(
        self, target: OccupancyMap, *, max_range: float = math.inf, truth: HeldOutTruth | None = None
    ) -> HeldOutTruth:
        """Compare a map with this scan, which the map must not have seen.

        Parameters
        ----------
        target : AdaptiveMap, FixedMap or OctoMap
            Of the same ``dim`` as the scan.
        max_range : float
            As for `insert_into` [m].
        truth : HeldOutTruth, optional
            Counts of other scans, to add to.

        Returns
        -------
        HeldOutTruth
            The counts of this scan, and of those in `truth`.
        """
        return target.evaluate(
            self.endpoints, self.origin, returned=self.returned, max_range=max_range, truth=truth
        )


def require_covariance(covariance: NDArray[np.float64], dim: int) -> None:
    """Raise ValueError unless ``insert`` of a map in `dim` dimensions takes it as a pose's covariance."""
    from ndtree._native import _core

    _core.pose_range_sigma(np.empty((0, dim)), np.zeros(dim), covariance)


def _floats(values: Any) -> NDArray[np.floating[Any]]:
    """As float32 where the values are float32, else as float64."""
    array = np.asarray(values)
    if array.dtype == np.float32:
        return array
    if array.dtype.kind in "cmM":  # Complex numbers and times, which NumPy takes for floats.
        raise TypeError
    return np.asarray(array, dtype=np.float64)
