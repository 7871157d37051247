# SPDX-License-Identifier: BSD-3-Clause
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Final, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self, Unpack

from ndtree._native.results import Changes as Changes
from ndtree._native.results import Claims as Claims
from ndtree._native.results import CompressReport as CompressReport
from ndtree._native.results import Frontier as Frontier
from ndtree._native.results import HistoryReport as HistoryReport
from ndtree._native.results import InformationGain as InformationGain
from ndtree._native.results import InsertReport as InsertReport
from ndtree._native.results import Leaves as Leaves
from ndtree._native.results import MapStats as MapStats
from ndtree._native.results import Match as Match
from ndtree._native.results import NearestOccupied as NearestOccupied
from ndtree._native.results import NoReturns as NoReturns
from ndtree._native.results import Path as Path
from ndtree._native.results import RayEnds as RayEnds
from ndtree.base.certificate import Certificate
from ndtree.base.scan import Scan
from ndtree.base.sensor import RangeSensor
from ndtree.base.typing import (
    ChangeOf,
    Insertion,
    MapOptions,
    Refinement,
    SimulationOptions,
    StateName,
    UnknownAs,
    World,
)

__version__: Final[str]
has_octomap: Final[bool]
most_cells: Final[float]
reach_sigmas: Final[float]
sample_run: Final[int]
sample_runs: Final[int]
thinnest_surface: Final[float]

class ReplacedFile:
    """A file that is written under a hidden name, and takes its place when it is whole."""

    def __init__(self, path: str | os.PathLike[str]) -> None: ...
    @property
    def temporary(self) -> str:
        """Path of the hidden file; of the empty text when it has its place or was discarded."""
    def discard(self) -> None:
        """Forget what was written."""

def commit_together(files: list[ReplacedFile]) -> None:
    """Put files into their places, all or none; of several, the one that names the others comes last."""

class HeldOutTruth:
    """How right a map is about beams that it was not built from; counts that add up.

    Of points every 10 cm along a returned beam up to 10 cm before its end, the shares that the map calls
    free, occupied and unknown; of end points, the share within 5 cm of an occupied cell; of ray casts
    along the beams, the share that ends within 10 cm of the measured range, and the median error; the last two also of casts that end at the likely surface
    instead of where they enter its cell.
    """

    def __init__(self) -> None: ...
    @property
    def samples(self) -> int:
        """Points looked at."""
    @property
    def free(self) -> float:
        """Share in [0, 1]; nan of none."""
    @property
    def occupied(self) -> float:
        """Share in [0, 1]; nan of none."""
    @property
    def unknown(self) -> float:
        """Share in [0, 1]; nan of none."""
    @property
    def endpoints(self) -> int:
        """End points looked at."""
    @property
    def endpoints_near(self) -> float:
        """Share of end points near an occupied cell."""
    @property
    def casts(self) -> int:
        """Rays cast."""
    @property
    def casts_within(self) -> float:
        """Share of casts that end where the beam did."""
    @property
    def balanced_accuracy(self) -> float:
        """Mean of `free` and `endpoints_near`."""
    @property
    def log_score(self) -> float:
        """Mean log-likelihood [nats] of free samples and end points, weighted equally; at most 0."""
    @property
    def median_error(self) -> float:
        """Median distance [m] between cast and beam; inf where most casts find nothing."""
    @property
    def surfaces_within(self) -> float:
        """As `casts_within`, of casts that end at the likely surface."""
    @property
    def surface_error(self) -> float:
        """As `median_error`, of casts that end at the likely surface."""
    def figures(self) -> dict[str, int | float | None]:
        """Counts and means by name, as reports have them; None for what nothing was counted of."""
    def __iadd__(self, other: HeldOutTruth) -> Self: ...

class Reliability:
    """How often beams end where a map says that they would; counts that add up.

    Of pairs of a held-out beam and an observed cell that it reaches, up to that of its end point. Columns
    have an entry for each group of pairs that are alike in state, size, number of beams and twentieth of
    the probability.
    """

    def __init__(self) -> None: ...
    @property
    def beams(self) -> int:
        """Beams asked about."""
    @property
    def ends_at_unknown(self) -> int:
        """Of these, that ended where nothing was observed."""
    @property
    def state(self) -> NDArray[np.int8]:
        """(k,) int8 of the cells: -1 unknown, 0 free, 1 occupied."""
    @property
    def size(self) -> NDArray[np.float64]:
        """(k,) float64: their edge [m]."""
    @property
    def power(self) -> NDArray[np.int64]:
        """(k,) int64: 2**power - 1 beams or more, and less than 2**(power + 1) - 1, are what their evidence is
        worth; -1 where a map does not keep that.
        """
    @property
    def pairs(self) -> NDArray[np.uint64]:
        """(k,) uint64: pairs of a beam and a cell."""
    @property
    def probability(self) -> NDArray[np.float64]:
        """(k,) float64: mean probability that the beam ends in the cell, `probability(of="hit")`."""
    @property
    def ends(self) -> NDArray[np.uint64]:
        """(k,) uint64: pairs whose beam ended in the cell."""
    def __iadd__(self, other: Reliability) -> Self: ...

class MovedEvidence:
    """Finds the points of a log that returned from moving things.

    All scans are given twice: to add(), which collects where beams ended, and then to look(), which asks each scan
    whether it saw these places empty: whether the beams around a place pass it by a cell and by the noise of both
    ranges. Then probability() answers.

    Let v scans have seen through a cell, and h found a surface there, in r rows between which others saw through. Of
    the scans that look at something that stands, a fraction of at most e = `error_rate` mostly sees through it, and any
    fraction of thin things; of something that moved a greater one, and it was there without a break. Bayes' rule gives
    the probability: 0.5 where no scan can tell, as none does whose beams are too far apart to meet what was there;
    below that where scans found it, and none saw through.

    Parameters
    ----------
    dim : int
        2 or 3.
    cell_size : float
        Points of one cell have one answer [m].
    range_sigma, range_sigma_quadratic : float
        The standard deviation of a range r is range_sigma + range_sigma_quadratic * r**2 [m].
    place_sigma, turn_sigma : float
        Standard deviations of how a scan lies to another one on each axis [m], and is turned about each [rad].
    noise_sigmas : float
        Standard deviations that a point and a beam each may be wrong by.
    error_rate : float
        Highest fraction of the scans looking at a standing thing that see through it.

    Raises
    ------
    ValueError
        If a value is out of its limits; it is named.
    """

    def __init__(
        self,
        *,
        dim: int,
        cell_size: float = ...,
        range_sigma: float = ...,
        range_sigma_quadratic: float = ...,
        place_sigma: float = ...,
        turn_sigma: float = ...,
        noise_sigmas: float = ...,
        error_rate: float = ...,
    ) -> None: ...
    @property
    def dim(self) -> int:
        """Of the points."""
    @property
    def cell_size(self) -> float:
        """Points of one cell have one answer [m]."""
    def add(
        self,
        points: ArrayLike,
        origin: ArrayLike,
        *,
        returned: ArrayLike | None = None,
        max_range: float = ...,
        range_sigma: ArrayLike | None = None,
    ) -> None:
        """The first pass: where a scan's beams ended.

        Parameters
        ----------
        points, origin, returned, max_range, range_sigma
            As of insert().

        Raises
        ------
        ValueError
            If shapes do not fit together; after look(); or for a beam that ends a million cells from the first.
        """
    def look(
        self,
        points: ArrayLike,
        origin: ArrayLike,
        *,
        returned: ArrayLike | None = None,
        max_range: float = ...,
        range_sigma: ArrayLike | None = None,
        threads: int = 0,
    ) -> None:
        """The second pass: what a scan sees of all places where beams ended.

        Parameters
        ----------
        points, origin, returned, max_range, range_sigma, threads
            As of insert(); the number of threads is that of the first call.

        Raises
        ------
        ValueError
            If shapes do not fit together.
        """
    def cells(self) -> NDArray[np.float64]:
        """Get the cells in which beams ended, each by the mean of its points; none before `look`.

        Returns
        -------
        ndarray of float64, (n, dim)
            [m], in an order that depends on the log alone.
        """

    def counts(self, points: ArrayLike) -> NDArray[np.uint32]:
        """What scans said of the cells of points, from which probability() follows.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n, 4) uint32
            How many scans saw through the cell, how many found a surface there, in how many rows between which others
            saw through, and how many passed with beams too far apart to tell; 0 where no beam ended. After a dozen
            scans in a row that see through, what was found before counts no more than these outweigh.
        """
    def probability(self, points: ArrayLike) -> NDArray[np.float32]:
        """That what returned at points was not part of what stands.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) float32
            0.5 where no beam ended, or no scan can tell.
        """

class Matcher:
    """Finds scans among points of surfaces.

    Made once, and used for many scans, from several threads at once. Its memory grows with the surface: about ten
    bytes for each cell within a brick of 8^dim cells that a point is near to, and up to 20 bytes for each other brick
    of the box around all points, 350 MB at most. Making it lets other threads run, and hears signals.

    Parameters
    ----------
    points : (n, dim) array of float
        On surfaces, dim 2 or 3 [m].
    cell_size : float
        Cell size of the grid of poses [m].
    sigma : float, optional
        Of an end point's distance from a surface, in the search [m]. Default: cell_size.
    radius : float, optional
        Radius around a point; the points in it shape a piece of the surface [m]. Default: four cells.
    noise : float
        Standard deviation of an end point across a surface, in the refinement [m].

    Raises
    ------
    ValueError
        A size is out of bounds, or the surface's box has more than 2^24 bricks.
    """

    def __init__(
        self,
        points: ArrayLike,
        *,
        cell_size: float = 0.05,
        sigma: float | None = None,
        radius: float | None = None,
        noise: float = 0.02,
    ) -> None: ...
    @property
    def dim(self) -> int:
        """int: dimension of space."""
    def match(
        self,
        points: ArrayLike,
        guess: ArrayLike,
        *,
        window: ArrayLike,
        information: ArrayLike | None = None,
        apart: float = 0.5,
        apart_angle: float = 0.35,
        second: bool = True,
    ) -> Match:
        """The best pose of a window around a guess, refined.

        All poses of the window's grid count, whose steps are a cell, and a turn that moves the farthest point by a cell:
        branch and bound finds the best of them surely.

        Parameters
        ----------
        points : (n, dim) array of float
            End points in the sensor's frame [m].
        guess : array of float
            As poses of `ScanHistory.insert`.
        window : (3,), (4,) or (6,) array of float
            How far the pose may be from the guess to each side: dx, dy, dyaw, or dx, dy, dz, dyaw, droll, dpitch [m, rad].
        information : (3, 3) or (6, 6) array of float, optional
            Inverse covariance of the guess, as `Match.covariance` has it: the refinement weighs it, less where the search
            ends far from the guess.
        apart, apart_angle : float
            As far from the best [m] or turned as far [rad], a pose is another one.
        second : bool
            Whether to look for the second-best pose, too.

        Returns
        -------
        Match

        Raises
        ------
        ValueError
            A shape is wrong, or the window negative or too large.
        """
    def modes(
        self,
        points: ArrayLike,
        guess: ArrayLike,
        *,
        window: ArrayLike,
        information: ArrayLike | None = None,
        most: int = 8,
        apart: float = 0.5,
        apart_angle: float = 0.35,
    ) -> list[Match]:
        """The best poses of a window that are apart from each other, each refined, the best first.

        Parameters
        ----------
        points, guess, window, information
            As of `match`.
        most : int
            Of them, at most; at least 1.
        apart, apart_angle : float
            As far from a better one [m] or turned as far [rad], a pose is another one.

        Returns
        -------
        list of Match
            Each with the covariance around itself alone, and without `second`. Empty where nothing is near.

        Raises
        ------
        ValueError
            As of `match`, or most is below 1.
        """
    def score(self, points: ArrayLike, pose: ArrayLike) -> float:
        """How well a scan fits at a pose: as `Match.score`, without a search.

        Parameters
        ----------
        points : (n, dim) array of float
            End points in the sensor's frame [m].
        pose : array of float
            As poses of `ScanHistory.insert`.

        Returns
        -------
        float
            Mean likelihood of the end points, 0 to 1; 0 without points.

        Raises
        ------
        ValueError
            A shape is wrong.
        """
    def match_all(
        self,
        scans: Sequence[ArrayLike],
        guesses: ArrayLike,
        *,
        window: ArrayLike,
        apart: float = 0.5,
        apart_angle: float = 0.35,
        threads: int = 0,
    ) -> list[Match]:
        """Poses of many scans; the same with any number of threads.

        Parameters
        ----------
        scans : sequence of (n, dim) array of float
            End points, each in its sensor's frame [m].
        guesses : array of float
            A pose for each.
        window, apart, apart_angle
            As of `match`.
        threads : int
            0: all cores.

        Returns
        -------
        list of Match
        """

class ScanHistory:
    """A map and the scans that made it: when poses are corrected, the map follows.

    Each scan has a key and a pose, and is kept in its sensor's frame with 8 bytes a beam, rounded to a 1024th of a
    smallest cell, or more if it reaches farther than 1024 cells. After any calls, each cell of the map is, bit for
    bit, what mapping the present scans at their present poses in the order in which they came makes of it, and so
    are its layers. Only cubes of max_cell_size are made anew that a moved scan crosses, before or after, and only by
    the scans that cross them. The map's counters add up the work that was done, so that ``==``, which compares them,
    too, tells it from a map that was made at once. A history cannot be pickled (a TypeError says so): save its map,
    and the scans as `scan` gives them.

    Parameters
    ----------
    dim : int
        2 or 3.
    layers : dict of str, optional
        As of AdaptiveMap. Scans keep their measurements: 4 bytes a beam that returned of a "mean", 12 of a "mean3", 2 of
        a "majority", 8 of a "latest", and none where all of a scan's are the same.
    options
        As of AdaptiveMap, with cells adapted by evidence.

    Raises
    ------
    ValueError
        As AdaptiveMap.
    """

    def __init__(
        self, *, dim: int, layers: Mapping[str, str] | None = None, **options: Unpack[MapOptions]
    ) -> None: ...
    @property
    def dim(self) -> int:
        """Dimension of space."""
    @property
    def map(self) -> AdaptiveMap:
        """AdaptiveMap: the map as it is now, a copy that shares its cells and takes no time."""
    @property
    def layers(self) -> dict[str, str]:
        """dict of str: what cells carry, name and rule."""
    @property
    def memory_bytes(self) -> int:
        """Bytes of the map, its layers and the scans with what they measured."""
    def insert(
        self,
        key: int,
        points: ArrayLike,
        pose: ArrayLike,
        *,
        origin: ArrayLike | None = None,
        returned: ArrayLike | None = None,
        range_sigma: ArrayLike | None = None,
        max_range: float = ...,
        threads: int = 0,
        pose_covariance: ArrayLike | None = None,
        layers: Mapping[str, ArrayLike] | None = None,
        number: int | None = None,
    ) -> InsertReport:
        """Map a scan, and keep it.

        Parameters
        ----------
        key : int
            By which the scan is found again.
        points : (n, dim) array of float
            End points in the sensor's frame [m].
        pose : array of float
            Pose of the sensor in the map: (3,) of x, y and yaw in 2-D, (7,) of x, y, z and a quaternion x, y, z, w in 3-D,
            or a (dim + 1, dim + 1) matrix.
        origin : (dim,) or (n, dim) array of float, optional
            Where beams start in the sensor's frame [m]. Default: at 0.
        returned, range_sigma, max_range, threads
            As of `OccupancyMap.insert`.
        pose_covariance : (3, 3) or (6, 6) array of float, optional
            As of `OccupancyMap.insert`, about the place of `pose`. What it makes of the beams stays theirs when the scan
            is moved.
        layers : dict of str and array, optional
            As of `OccupancyMap.insert`: each beam's value for layers of the map.
        number : int, optional
            As of `OccupancyMap.insert`: which beams of a dense scan are sampled. Default: one more than that of the
            scan before. The scan keeps it when others are removed: mapping the scans that are left with their numbers
            makes the same map.

        Returns
        -------
        InsertReport

        Raises
        ------
        ValueError
            The key is there already, the number is not above all before, the pose is wrong, or as
            `OccupancyMap.insert`; nothing has changed.
        """
    def move(self, poses: dict[int, ArrayLike], *, threads: int = 0) -> HistoryReport:
        """Move scans to other poses.

        Parameters
        ----------
        poses : dict
            From keys to poses, as of `insert`; scans that are left out stay where they are.
        threads : int
            As of `OccupancyMap.insert`.

        Returns
        -------
        HistoryReport

        Raises
        ------
        KeyError
            There is no scan with this key; nothing has changed.
        ValueError
            A pose is wrong; nothing has changed.
        """
    def remove(self, keys: Sequence[int], *, threads: int = 0) -> HistoryReport:
        """Take scans out of the map.

        Parameters
        ----------
        keys : sequence of int
            Keys of the scans.
        threads : int
            As of `OccupancyMap.insert`.

        Returns
        -------
        HistoryReport

        Raises
        ------
        KeyError
            There is no scan with this key; nothing has changed.
        ValueError
            A key is given twice; nothing has changed.
        """
    def freeze(self, count: int, *, threads: int = 0) -> None:
        """Let the first scans stay where they are from now on: their beams and keys are forgotten.

        The map keeps what they made of it, so that memory is bounded on a long way. It costs mapping them once more, and
        the memory of a map of them.

        Parameters
        ----------
        count : int
            Of scans, in the order in which they came.
        threads : int
            As of `OccupancyMap.insert`.

        Raises
        ------
        ValueError
            There are fewer; nothing has changed.
        """
    @property
    def num_frozen(self) -> int:
        """Scans that `freeze` was called for."""
    def keys(self) -> list[int]:
        """Keys of all scans, in the order in which they came.

        Returns
        -------
        list of int
        """
    def pose(self, key: int) -> NDArray[np.float64]:
        """Pose of a scan's sensor in the map.

        Parameters
        ----------
        key : int
            Key of the scan.

        Returns
        -------
        (dim + 1, dim + 1) float64

        Raises
        ------
        KeyError
            There is no scan with this key.
        """
    def scan(self, key: int) -> Scan:
        """A scan in the map's frame, as the map took it in.

        Parameters
        ----------
        key : int
            Key of the scan.

        Returns
        -------
        Scan

        Raises
        ------
        KeyError
            There is no scan with this key.
        """
    def measurements(self, key: int) -> dict[str, NDArray[Any]]:
        """What a scan measured for the layers, as the map took it in.

        Parameters
        ----------
        key : int
            Key of the scan.

        Returns
        -------
        dict of str and array
            By the name of a layer, one entry for each beam of ``scan(key)``: (n,), or (n, 3) for "mean3", int64 for
            "majority"; nan, or -1 for labels, where a beam did not return. Layers that the scan was given nothing for
            are left out.

        Raises
        ------
        KeyError
            There is no scan with this key.
        """
    def __len__(self) -> int: ...
    def __contains__(self, key: int) -> bool: ...

class SeenSpace:
    """Points drawn uniformly around the end points of a log, and whether some scan saw them.

    A scan has a point in view if its beam that is nearest in direction is at most `spacings` times the median
    distance between neighbouring beams' directions away. It sees the point if that beam goes past it, or
    returned at most `tolerance` before it. Beams are cut at `max_range`, and one that did not return sees up to
    where it ends. Beams from several origins are scans of their own, and a single beam sees nothing. In a
    simulated world the exact line of sight says what is seen of what is in view, as far as the sensor reaches.

    Parameters
    ----------
    scans : iterable of Scan
        All of the same dim; 2, 3 or 4.
    max_range : float
        As for insert() [m].
    simulation : SimulatedLog2 or SimulatedLog3, optional
        The log that the scans are from. Left out: beams alone say what was seen.
    samples : int
        Number of points.
    spacings : float
        Of beams, in which a point is in view.
    tolerance : float
        Distance behind its end point that a beam which returned sees [m].
    margin : float
        The points are drawn up to so far [m] around the box ...
    middle : float
        ... that holds this share of the end points on each axis.
    seed : int
        Seed of the drawn points; equal seeds and logs give equal points.

    Raises
    ------
    ValueError
        If there is no scan, the scans differ in dim, or a value is out of its limits; it is named.
    """

    def __init__(
        self,
        scans: Iterable[Scan],
        *,
        max_range: float = ...,
        simulation: SimulatedLog2 | SimulatedLog3 | None = None,
        samples: int = ...,
        spacings: float = ...,
        tolerance: float = ...,
        margin: float = ...,
        middle: float = ...,
        seed: int = ...,
    ) -> None: ...
    @property
    def dim(self) -> int:
        """Of the points."""
    @property
    def points(self) -> NDArray[np.float64]:
        """(n, dim) float64 [m]; none without a valid beam."""
    @property
    def seen(self) -> NDArray[np.bool_]:
        """(n,) bool: whether some scan saw the point."""
    @property
    def box(self) -> NDArray[np.float64] | None:
        """(2, dim) float64: lower and upper corner of where the points are [m]; None without a valid beam."""

class DistanceField:
    """Signed distances to obstacles at the centres of equal cells that fill a box."""

    @property
    def values(self) -> NDArray[np.float32]:
        """(nx, ny[, nz]) float32 [m]: positive outside obstacles, negative inside."""
    @property
    def lower(self) -> NDArray[np.float64]:
        """(dim,) float64: lower corner of the first cell [m]."""
    @property
    def centers(self) -> NDArray[np.float64]:
        """(nx, ny[, nz], dim) float64: where `values` are [m]."""
    @property
    def cell_size(self) -> float:
        """[m]"""
    @property
    def max_distance(self) -> float:
        """Farther away, values are this [m]."""
    def update(self, map: OccupancyMap, *, since: OccupancyMap) -> None:
        """Follow the map: afterwards every value is what distance_field() would give now, bit for bit.

        Only points are looked at for which something that changed is no farther away than what was nearest. Other threads that
        ask the field meanwhile wait, and get answers of before or after.

        Parameters
        ----------
        map : OccupancyMap
            The map that the field was made of.
        since : OccupancyMap
            A snapshot() of it from when the field was made, or last updated.

        Raises
        ------
        ValueError
            The maps are not of the same kind, or not of the field's dimension.
        """
    @overload
    def distance(self, points: Sequence[float]) -> float:
        """Distance between the centres of cells, linear on each axis.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) float64
            [m]; nan outside the field.
        """
    @overload
    def distance(self, points: ArrayLike) -> NDArray[np.float64]: ...
    def gradient(self, points: ArrayLike) -> NDArray[np.float64]:
        """Gradient of distance(): away from obstacles.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n, dim) float64
            Of length 1, or nearly, but where several obstacles are as near; nan outside the field.
        """

class Shape:
    """A robot's body in its own frame: Sphere, Capsule, Box, or several by `a | b`."""

    @property
    def reach(self) -> float:
        """float: no point of the body is farther from its origin [m]."""
    def __or__(self, other: Shape) -> Shape: ...

def Sphere(radius: float, center: ArrayLike | None = None) -> Shape:
    """All points at most radius from a centre.

    Parameters
    ----------
    radius : float
        >= 0 [m].
    center : (dim,) array of float, optional
        In the body's frame [m]. Default: its origin.
    """

def Capsule(a: ArrayLike, b: ArrayLike, radius: float) -> Shape:
    """All points at most radius from a segment.

    Parameters
    ----------
    a, b : (dim,) array of float
        Its ends in the body's frame [m].
    radius : float
        >= 0 [m].
    """

def Box(size: ArrayLike, center: ArrayLike | None = None, *, rotation: ArrayLike | None = None) -> Shape:
    """A box in the body's frame.

    Parameters
    ----------
    size : (dim,) array of float
        Edge lengths, >= 0 [m].
    center : (dim,) array of float, optional
        [m]. Default: the frame's origin.
    rotation : (dim, dim) array of float, optional
        Its columns are the box's axes. Default: the frame's axes.
    """

class OccupancyMap:
    """What all maps have in common. Make an AdaptiveMap or a FixedMap."""

    @property
    def dim(self) -> int:
        """Dimension of space."""
    @property
    def branching(self) -> int:
        """Children of a node along each axis."""
    @property
    def refinement(self) -> str:
        """Name of the rule that decides on cell sizes."""
    @property
    def min_cell_size(self) -> float:
        """float: edge of the smallest cells [m]; of all cells of a fixed map."""
    @property
    def disputed(self) -> float:
        """float: the fraction of the observed volume where the evidence contradicts itself in time.

        There at least two beams ended in a cell before at least twelve scans in a row all passed it, or the other
        way round, as where people walk, doors move or poses are wrong. ``leaves().disputed`` says where. Cells
        that have changed forget what was before: they are not disputed any more. nan where nothing was observed,
        and of maps whose cells count no such scans: fixed ones, OctoMap, and those of the paper's rules.
        """
    @property
    def max_cell_size(self) -> float:
        """float: edge of the largest cells that are updated [m].

        That is the smallest times a power of `branching`, the largest that the option of this name allows.
        """
    @property
    def options(self) -> MapOptions:
        """dict of float: the options that the map reads."""
    def insert(
        self,
        points: ArrayLike,
        origin: ArrayLike,
        *,
        returned: ArrayLike | None = None,
        range_sigma: ArrayLike | None = None,
        max_range: float = ...,
        threads: int = 0,
        window: ArrayLike | None = None,
        layers: Mapping[str, ArrayLike] | None = None,
        number: int | None = None,
        moved: bool = False,
        pose_covariance: ArrayLike | None = None,
    ) -> InsertReport:
        """Integrate a scan.

        All beams together, so that their order does not matter; a fixed map, and one refined as the paper has it,
        beam by beam (Sec. III of the paper).

        Parameters
        ----------
        points : (n, dim) array of float
            End points in the map frame [m]. A beam that is not finite or of zero length is skipped and counted.
        origin : (dim,) or (n, dim) array of float
            Sensor position [m], one for all beams or one each.
        returned : (n,) array of bool, optional
            False: nothing was hit, the space up to the point is free. Default: all True.
        range_sigma : (n,) array of float, optional
            Standard deviation of each range [m], > 0, where it is known beam by beam. Default: the map's options say.
            OctoMap has no use for it.
        max_range : float
            Longer beams are free up to there and have no end point [m].
        threads : int
            Number of threads for a large scan; 0: as many as the machine has cores. The map is the same, bit for bit, for
            every number. Of a map refined as the paper has it there is only one.
        window : (2, dim) array of float, optional
            Lower and upper corner [m]: only cells in this box change, and become, bit for bit, what they would
            without it. In it are all cells of `max_cell_size` (of a fixed map: all cells) that share a volume with it.
        layers : dict of str and array, optional
            By the name of a layer of the map, each beam's value for the cell in which it ends: (n,), or (n, 3) for
            "mean3". Values of beams that did not return are ignored. See `layer`.
        number : int, optional
            The scan's number among all scans, from 0: each number samples other beams of a dense scan. For maps that
            take only some of the scans, as the parts of a distributed one do. Default: ``stats().scans``.
        moved : bool
            Whether the report says in ``moved`` how probable it is that each point returned from what moves: what
            `moved` of the map said of it just before the call; 0.5 for beams that did not return within `max_range`.
            Only space that was seen free earlier can tell, so the first scans of a place say nothing.
        pose_covariance : (3, 3) or (6, 6) array of float, optional
            How sure the sensor's pose is: covariance of x, y and yaw in 2-D; of x, y, z and rotations about x, y, z in
            3-D, as ROS' PoseWithCovariance has them; 2-D maps take x, y and yaw of those, too. Along the axes of the
            map and about `origin`. Each beam's standard deviation becomes sqrt(sigma² + along² + across² / 4), where
            sigma is `range_sigma` or the options', and the others are those of its end point. All zero: nothing changes.
            Maps of every refinement use it, fixed ones, too; OctoMap has no use for it.

        Returns
        -------
        InsertReport

        Raises
        ------
        ValueError
            A shape is wrong, an option out of bounds, the one origin not finite, a point too far away for the
            lattice of cells, a beam longer than 2**20 of the smallest cells, or, without a max_range, most beams
            longer than 20,000. The map is then unchanged.
        MemoryError
            The map would hold more than max_memory. If that was given, the map is then unchanged.
        UserWarning
            A beam is longer than 20,000 of the smallest cells, and no max_range is given: points in millimetres, or in
            another frame than their origin.
        KeyboardInterrupt
            Ctrl-C, heard within a fraction of a second; the map is then unchanged. So with all long calls.
        """
    @property
    def layers(self) -> dict[str, str]:
        """dict of str: what cells carry, name and rule."""
    def layer(self, name: str, points: ArrayLike) -> NDArray[Any]:
        """What the cells around points carry.

        A cell of which beams were told something (see `insert`) has the mean of it, the label that most gave, or the
        latest time. Where it splits, its parts have the same; where cells merge, the rule joins theirs. So
        ``m.layer("color", m.leaves().center)`` is what the leaves carry.

        Parameters
        ----------
        name : str
            Name of the layer.
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) float64 of "mean" and "latest", (n, 3) float64 of "mean3", (n,) int64 of "majority"
            nan, or -1, where the cell carries nothing: unknown, or no beam ended in it.

        Raises
        ------
        ValueError
            The map has no such layer; those that it has are named.
        """
    def compress(
        self,
        *,
        max_loss: float | None = None,
        max_leaves: int | None = None,
        max_bytes: int | None = None,
    ) -> CompressReport:
        """Make the map smaller, losing as little information as possible.

        Siblings join in the order of what that loses for each leaf saved: the logarithm of how much better several
        cells explain the beams than one does (a Bayes factor), and the divergence of their occupancies from the one of
        the cell that takes their place. What was never observed stays unknown. Later scans go on from there. Only for maps refined by "evidence".

        Parameters
        ----------
        max_loss : float, optional
            Most information that all merges together may lose [bits].
        max_leaves : int, optional
            Observed leaves that may remain.
        max_bytes : int, optional
            Memory that the map may hold.

        Returns
        -------
        CompressReport

        Raises
        ------
        ValueError
            No limit is given, one is out of bounds or cannot be met, or the map has another refinement. The map is then
            unchanged.
        """
    def shrink_to_fit(self) -> None:
        """Give the memory back that merging has freed; no answer changes. For an OctoMap, nothing."""
    @overload
    def probability(
        self, points: Sequence[float], *, of: Literal["occupied", "hit"] | None = None, interval: None = None
    ) -> float:
        """Probability that space is occupied at points, or that beams end there.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].
        of : str, optional
            "occupied": that space is occupied, by the log-odds which the state is of. "hit": that a beam which reaches the
            cell ends in it, as held-out beams do. Left out: "occupied", and with an interval "hit".
        interval : float, optional
            In (0, 1): also say within which bounds the fraction of beams that end in the cell lies with this probability.
            They are those of a Beta posterior of the beams that ended in the cell and that passed it, eight of which are
            worth one, since beams through a cell are alike.

        Returns
        -------
        (n,) float32, or a tuple of three with an interval
            Where unknown, outside the map or not observed: 0.5 for "occupied", nan for "hit". With an interval: the
            probability, the lower and the upper bound.

        Raises
        ------
        ValueError
            If `of` is another word; if the interval is not in (0, 1), not of "hit", or asked of an OctoMap, which keeps no
            counts.
        """
    @overload
    def probability(
        self, points: ArrayLike, *, of: Literal["occupied", "hit"] | None = None, interval: None = None
    ) -> NDArray[np.float32]: ...
    @overload
    def probability(
        self, points: Sequence[float], *, of: Literal["hit"] | None = None, interval: float
    ) -> tuple[float, float, float]: ...
    @overload
    def probability(
        self, points: ArrayLike, *, of: Literal["hit"] | None = None, interval: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
    @overload
    def state(self, points: Sequence[float]) -> int:
        """State of space at points.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) int8
            -1 unknown, 0 free, 1 occupied.
        """
    @overload
    def state(self, points: ArrayLike) -> NDArray[np.int8]: ...
    @overload
    def occupied_within(self, points: Sequence[float], radius: float) -> bool:
        """Whether some occupied cell is near each point.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].
        radius : float
            Largest distance from the point to the cell's border, >= 0 [m].

        Returns
        -------
        (n,) bool
        """
    @overload
    def occupied_within(self, points: ArrayLike, radius: float) -> NDArray[np.bool_]: ...
    @overload
    def cast_rays(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        max_range: float = ...,
        unknown: Literal["pass", "stop"] = "pass",
        at: Literal["surface", "cell"] = "surface",
        details: Literal[False] = False,
    ) -> NDArray[np.float64]:
        """Distance along rays: to the likely surface in the first occupied leaf, or to that leaf (Sec. II-D).

        Parameters
        ----------
        origins : (dim,) or (n, dim) array of float
            Where the rays start, one for all or one each [m].
        directions : (n, dim) array of float
            Of any length but zero.
        max_range : float
            Largest distance to look at, > 0 [m].
        unknown : str
            "pass": unknown space does not stop a ray, but right behind a cell that is free and known to hold
            something, as along grazed walls: that cell counts as occupied. "stop": it does, also where the ray
            leaves the map.
        at : str
            "surface": to where the surface is likely to be in that leaf, the end of half of the beams that come this way by the
            hit rates of this leaf and of those behind it. "cell": to where the ray enters it, at most 3/4 of a smallest cell nearer.
        details : bool
            Whether to return what each ray ends at, too.

        Returns
        -------
        (n,) float64, or RayEnds with details
            Metres; nan where there is none. With at="cell" 0 for a ray that starts in an occupied leaf. RayEnds has .distance, .state,
            and .lower and .size of the cell.

        Raises
        ------
        ValueError
            A shape is wrong, max_range not > 0, or a ray is not finite or has a zero direction; it is named.
        """
    @overload
    def cast_rays(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        max_range: float = ...,
        unknown: Literal["pass", "stop"] = "pass",
        at: Literal["surface", "cell"] = "surface",
        details: Literal[True],
    ) -> RayEnds: ...
    def evaluate(
        self,
        points: ArrayLike,
        origin: ArrayLike,
        *,
        returned: ArrayLike | None = None,
        max_range: float = ...,
        truth: HeldOutTruth | None = None,
    ) -> HeldOutTruth:
        """Compare the map with beams that it was not built from.

        Parameters
        ----------
        points, origin, returned, max_range
            As for insert(). Only returned beams within max_range count.
        truth : HeldOutTruth, optional
            Counts of earlier scans to add to; it is not changed itself.

        Returns
        -------
        HeldOutTruth
        """
    def moved(self, points: ArrayLike) -> NDArray[np.float32]:
        """Probability that points returned from things that do not stand there for good, by the map's evidence.

        A point in free space moved, or came there by an error, unless an occupied cell is as near as a smallest cell
        and three standard deviations of a range; one that the last scan passed leaves the answer open, 0.5. While the
        cell of an adaptive map remembers that a beam ended in it, the map cannot tell whether something thin stands there
        or something left: 0.5 at most. So it tells of points that are not in it yet, and of others only where it has
        changed since; `MovedEvidence` asks the scans themselves.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) float32
            0.5 where the map does not know, at most 0.5 where it is occupied.
        """
    def reliability(
        self,
        points: ArrayLike,
        origin: ArrayLike,
        *,
        returned: ArrayLike | None = None,
        max_range: float = ...,
        counts: Reliability | None = None,
    ) -> Reliability:
        """Count how often beams that the map was not built from end where it says that they would.

        Parameters
        ----------
        points, origin, returned, max_range
            As for insert(). Only returned beams within max_range count.
        counts : Reliability, optional
            Of earlier scans, to add to; it is not changed itself.

        Returns
        -------
        Reliability
        """
    def certify(
        self, scans: Iterable[Scan], *, confidence: float = 0.95, max_range: float = ...
    ) -> Certificate:
        """Bound the share of what a map calls free that is occupied, by scans that it was not made of.

        Of the points along a scan's beams, every 0.1 m and at their ends, the map calls some free; the scan's
        share is that of end points among these. Of n scans and one more, in an order that says nothing, the last
        has a share of at most the k-th smallest of the others' with a probability of at least k / (n + 1): a
        conformal bound, without any assumption about sensor, world or map, or how beams of one scan depend on
        each other. It is for scans from where the held-out ones are from, so hold out scans from all along the
        way, as every tenth. Of less than confidence / (1 - confidence) scans, which is 19 at 95 %, it is 1.

        Parameters
        ----------
        scans : iterable of Scan
            Held out from the map.
        confidence : float
            In (0, 1).
        max_range : float
            Beams that are longer say nothing [m].

        Returns
        -------
        Certificate

        Raises
        ------
        ValueError
            If confidence or max_range is out of its limits.
        """
    def claims(self, space: SeenSpace) -> Claims:
        """Compare what the map calls free and unknown with what was seen.

        Parameters
        ----------
        space : SeenSpace
            Space seen by the mapped scans.

        Returns
        -------
        Claims

        Raises
        ------
        ValueError
            If the space has another dim than the map.
        """
    @overload
    def to_grid(
        self,
        box: ArrayLike,
        cell_size: float | None = None,
        *,
        values: Literal["state"] = "state",
        wall_depth: float | None = None,
    ) -> NDArray[np.int8]:
        """A part of the map as a dense array.

        Entry [i, j, ...] is what the map says of the cell from lower + (i, j, ...) * cell_size to
        lower + (i + 1, j + 1, ...) * cell_size, half-open: the first axis is x, the second y, the third z. That is
        what it says at the cell's centre; but a cell larger than the map's smallest is occupied if some occupied cell
        overlaps it, else free if some free one does, else unknown, and has the largest log-odds of those known cells.

        Parameters
        ----------
        box : (2, dim) array of float
            Lower and upper corner [m]. Cells begin at the lower one, as many as cover the box.
        cell_size : float, optional
            [m]; left out, the map's smallest.
        values : {"state", "probability", "log_odds"}
            The stored values.
        wall_depth : float, optional
            Of states: how far behind free cells of the box occupied cells larger than the smallest are drawn [m];
            beyond they are unknown. Left out, all of each; see save_map_server().

        Returns
        -------
        array of int8, or of float32
            One axis for each of space. States are -1 unknown, 0 free, 1 occupied; unknown space has the probability
            0.5 and the log-odds 0.

        Raises
        ------
        ValueError
            A shape is wrong, the box not finite or not from low to high, or cell_size or wall_depth not > 0.
        """
    @overload
    def to_grid(
        self, box: ArrayLike, cell_size: float | None = None, *, values: Literal["probability", "log_odds"]
    ) -> NDArray[np.float32]: ...
    def states_in(self, lower: ArrayLike, upper: ArrayLike) -> NDArray[np.bool_]:
        """Which states there are in boxes.

        Parameters
        ----------
        lower, upper : (n, dim) array of float
            Corners [m]. The boxes are closed: a cell that shares a point with one counts.

        Returns
        -------
        (n, 3) bool
            Whether something in the box is unknown, free, occupied. Space outside the map is unknown.

        Raises
        ------
        ValueError
            A shape is wrong, or a box not from low to high.
        """
    @overload
    def distance_to_occupied(self, points: Sequence[float]) -> float:
        """Distance from points to the nearest occupied cell.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) float64
            To the cell's border, 0 inside [m]; nan where the map has no occupied cell, or the point is nan; inf of points
            beyond 1e154.
        """
    @overload
    def distance_to_occupied(self, points: ArrayLike) -> NDArray[np.float64]: ...
    def map_server_image(
        self,
        *,
        cell_size: float | None = None,
        height: tuple[float, float] | None = None,
        wall_depth: float | None = None,
    ) -> tuple[NDArray[np.uint8], tuple[float, float], float]:
        """The image that save_map_server() writes.

        Parameters
        ----------
        cell_size, height, wall_depth
            As of save_map_server().

        Returns
        -------
        pixels : (rows, columns) uint8
            254 free, 0 occupied, 205 unknown; the first row is the one with the largest y.
        origin : (x, y)
            Lower left corner of the last row's first pixel [m].
        cell_size : float
            Edge of a pixel [m].
        """
    def leaves(
        self,
        box: ArrayLike | None = None,
        *,
        states: Sequence[StateName] | None = None,
    ) -> Leaves:
        """Leaves as arrays.

        Parameters
        ----------
        box : (2, dim) array of float, optional
            Lower and upper corner [m]: only leaves that touch it. Default: all.
        states : sequence of str, optional
            Only leaves of these: "free", "occupied", "unknown". Default: all.

        Returns
        -------
        Leaves

        Raises
        ------
        ValueError
            A shape or a name is wrong, or the box not from low to high, or nan.
        """
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """The smallest box around all cells that were observed.

        Returns
        -------
        (lower, upper) or None
            Two (dim,) float64 [m]; None if nothing was observed.
        """
    def nearest_occupied(self, points: ArrayLike, *, max_distance: float = ...) -> NearestOccupied:
        """The nearest point of occupied space, for each point.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].
        max_distance : float
            Largest distance to look at, >= 0 [m].

        Returns
        -------
        NearestOccupied
            .distance (n,), inf where there is nothing, 0 in an occupied cell; .point (n, dim), nan where there is
            nothing.
        """
    def match(
        self,
        points: ArrayLike,
        guess: ArrayLike,
        *,
        window: ArrayLike,
        cell_size: float | None = None,
        apart: float = 0.5,
        apart_angle: float = 0.35,
    ) -> Match:
        """The pose of a scan in the map: the best of a window around a guess, refined.

        Parameters
        ----------
        points : (n, dim) array of float
            End points in the sensor's frame, dim 2 or 3 [m].
        guess : array of float
            Pose of the sensor, as in `ScanHistory.insert`.
        window : (3,), (4,) or (6,) array of float
            How far the pose may be from the guess: dx, dy, dyaw, or dx, dy, dz, dyaw, droll, dpitch [m, rad].
        cell_size : float, optional
            Cell size of the grid of poses [m]. Default: that of the smallest cells.
        apart, apart_angle : float
            As far from the best [m] or turned as far [rad], a pose is another one.

        Returns
        -------
        Match

        Raises
        ------
        ValueError
            A shape is wrong, or the window negative or too large.

        See Also
        --------
        matcher : to match many scans with a map that does not change.
        """
    def matcher(
        self,
        box: ArrayLike | None = None,
        *,
        cell_size: float | None = None,
        sigma: float | None = None,
        radius: float | None = None,
        noise: float | None = None,
    ) -> Matcher:
        """A matcher of the map's surfaces as they are now: occupied cells beside free space.

        Parameters
        ----------
        box : (2, dim) array of float, optional
            Only cells that share a point with it [m].
        cell_size : float, optional
            Cell size of the grid of poses [m]. Default: that of the smallest cells.
        sigma : float, optional
            As of `Matcher`.
        radius : float, optional
            As of `Matcher`. Default: ten cells.
        noise : float, optional
            As of `Matcher`. Default: the map's range_sigma.

        Returns
        -------
        Matcher
        """
    def distance_field(
        self,
        box: ArrayLike,
        cell_size: float,
        *,
        max_distance: float = 2.0,
        unknown: UnknownAs = "free",
    ) -> DistanceField:
        """Signed Euclidean distance to the nearest obstacle, as of collides(), on a grid; exact for cells of any size.

        Parameters
        ----------
        box : (2, dim) array of float
            Lower and upper corner of the grid [m]; rounded up to whole cells.
        cell_size : float
            Cell size of the grid, > 0 [m]; any.
        max_distance : float
            Largest distance, > 0 [m]: values farther away are set to it.
        unknown : str
            How to treat unknown space, outside the map too: "free" or "occupied".

        Returns
        -------
        DistanceField
            .values (nx, ny[, nz]) float32, positive outside obstacles and negative inside; .distance(points) and
            .gradient(points) between the centres.

        Raises
        ------
        ValueError
            A value or a shape is wrong; the message names it.
        """
    def frontiers(self, box: ArrayLike | None = None, *, min_cells: float = 8.0) -> list[Frontier]:
        """Where free space ends and unknown space begins.

        Parameters
        ----------
        box : (2, dim) array of float, optional
            Lower and upper corner [m]: free cells that touch it count. Default: everywhere.
        min_cells : float
            Frontiers with a border smaller than this many faces of smallest cells are left out.

        Returns
        -------
        list of Frontier
            The largest border first: .center, .direction, .area, .cells and .size of the free cells.
        """
    @overload
    def collides(self, shape: Shape, poses: Sequence[float], *, unknown: UnknownAs = "free") -> bool:
        """Whether a body meets an obstacle, in each of many poses.

        An obstacle is an occupied cell, or a free one known to hold something thinner than it, as a rod of a fence.

        Parameters
        ----------
        shape : Shape
            Sphere, Capsule, Box, or several by ``a | b``.
        poses : (n, dim + 1, dim + 1) array of float; or (n, 3) in 2-D, (n, 7) in 3-D
            From the body's frame to the map's: homogeneous matrices; or x, y and yaw; or x, y, z and a quaternion qx, qy,
            qz, qw [m, rad].
        unknown : str
            How to treat unknown space, outside the map too: "free" or "occupied".

        Returns
        -------
        (n,) bool
            Exact for cells of any size; touching counts.

        Raises
        ------
        ValueError
            A pose is not finite, its rotation mirrors or is none, or the last row of its matrix is not 0, ..., 0, 1; it is
            named.
        """
    @overload
    def collides(
        self, shape: Shape, poses: ArrayLike, *, unknown: UnknownAs = "free"
    ) -> NDArray[np.bool_]: ...
    def path_collides(self, shape: Shape, poses: ArrayLike, *, unknown: UnknownAs = "free") -> int:
        """The first pose of a path that a body cannot move to.

        Between two poses it moves straight and turns evenly, the shorter way; it is looked at in steps of at most half
        a smallest cell, so that what reaches less than a quarter of one into the way may be missed.

        Parameters
        ----------
        shape, poses, unknown
            As for collides().

        Returns
        -------
        int
            Index of the pose; -1 if the whole path is free.
        """
    def plan(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        *,
        body: Shape,
        clearance: float = 0.0,
        unknown: Literal["blocked", "free"] | float = "blocked",
        max_seconds: float | None = None,
        headings: int = 16,
    ) -> Path:
        """Find a short path for a body that does not turn; or in the plane, between poses, for one that does.

        Any-angle search over cells of free space as large as they can be, and through gaps that are hardly wider than the
        body, then pulled tight. The volume that the body sweeps along each segment meets no obstacle of collides(). The path is nearly
        the shortest and not proved to be. Where there is none, its reason says whether that is proved. The same map gives
        the same path. For more than one question, a Planner keeps what it found out.

        Between poses of x, y and yaw the body turns in place, and moves without turning in between. A turn is free for
        certain: it is looked at in small steps, with a body that is larger by what it moves in them.

        Parameters
        ----------
        start, goal : (dim,) array of float
            Where the origin of the body is [m]; in the plane also (3,): x, y [m] and yaw [rad].
        body : Shape
            Sphere, Capsule, Box, or several by ``a | b``, in its orientation.
        clearance : float
            Least distance of the body to obstacles [m], >= 0; a Box keeps more at its corners.
        unknown : {"blocked", "free"} or float
            How to treat unknown space: as an obstacle, free, or passable at a cost, 1 to 1e6: the factor of its length where the body may
            touch it.
        max_seconds : float, optional
            Longest time of the search [s]. Default: no limit.
        headings : int
            Number of angles at which a turning body may move, 4 to 256: equally spaced from the start's; the goal's is added.

        Returns
        -------
        Path
            True if one was found; its status and reason say why not. Its points are poses if start and goal are.

        Raises
        ------
        ValueError
            The body collides at the start or the goal: the message names the cell, and the nearest place where it fits.
            An argument has a wrong shape or value; the map is 4-D or an OctoMap.
        KeyboardInterrupt
            Ctrl-C.
        """
    def information_gain(self, poses: ArrayLike, sensor: RangeSensor, *, threads: int = 0) -> InformationGain:
        """What a scan from each of several poses is expected to see anew.

        A beam sees along its way, through free and unknown space, up to what ends `cast_rays`, and there the outermost
        smallest cell. It is as wide as its spacing times the distance, and at most a smallest cell. Large cells count as
        the smallest ones that they stand for; so it is what equal cells would give.

        Parameters
        ----------
        poses : (n, dim + 1, dim + 1) array of float; or (n, 3) in 2-D, (n, 7) in 3-D; or (n, dim)
            From the sensor's frame to the map's, as for collides(); or positions alone.
        sensor : RangeSensor
            A sensor of the map's dimension.
        threads : int
            Number of threads; 0: as many as there are cores. The result is the same, bit for bit.

        Returns
        -------
        InformationGain
            .volume, (n,) float64, of unknown space [m^dim]: one that occludes nothing by default, else with the
            probability that beams get there, see RangeSensor.mean_free_path. .bits, (n,) float64: the mutual information
            of the next look at each smallest cell that is seen and of its hit rate, summed up.

        Raises
        ------
        ValueError
            A pose is wrong, or the sensor is of another dimension; it is named. The map is 4-D or an OctoMap.
        KeyboardInterrupt
            Ctrl-C.
        """
    def crop(self, box: ArrayLike) -> None:
        """Forget all cells but those that share a volume with a box.

        Parameters
        ----------
        box : (2, dim) array of float
            Lower and upper corner [m].
        """
    def clear(self, where: Shape | ArrayLike, pose: ArrayLike | None = None) -> None:
        """Forget what is in a box, or where a body is: it is unknown then.

        Larger cells on the border are divided; of smallest cells there, those go that share a volume with the box, or a
        point with the body. So the body `collides` with nothing afterwards.

        Parameters
        ----------
        where : (2, dim) array of float, or Shape
            Lower and upper corner [m]; or Sphere, Capsule, Box, or several by ``a | b``, in 2-D and 3-D.
        pose : array of float, optional
            Pose of the Shape in the map, as one of `collides`; left out, the Shape is in the map's frame.

        Raises
        ------
        ValueError
            The box has no volume, or the pose is none; for OctoMap.
        """
    def mark(
        self,
        where: Shape | ArrayLike,
        state: Literal["free", "occupied"],
        pose: ArrayLike | None = None,
        *,
        beams: int = 16,
    ) -> None:
        """Mark space as free or occupied by hand.

        The cells are the same that `clear` forgets with the same arguments; what was known of them is replaced. Each
        smallest cell gets the evidence of ``beams`` beams that ended in it, or passed it, and larger cells what their
        smallest ones have together, as far as cells remember (`evidence_memory`, `free_memory`; in maps with equal cells
        and the paper's, the bounds of log-odds). So later beams may change it.

        Parameters
        ----------
        where, pose
            As for `clear`.
        state : str
            "free" or "occupied".
        beams : int
            From 1 to 511.

        Raises
        ------
        ValueError
            As `clear`, or the space is out of the map's reach.
        MemoryError
            The map would hold more than its `max_memory`; it is as before then.
        """
    def keep_near(self, center: ArrayLike, radius: float) -> None:
        """Forget all cells that are farther than a radius from a point.

        A window that moves with a robot: in time proportional to what goes, and what lies on the border. The map goes
        on growing elsewhere.

        Parameters
        ----------
        center : (dim,) array of float
            [m]
        radius : float
            > 0 [m]; inf keeps everything.
        """
    def snapshot(self) -> Self:
        """The map as it is now, which stays so while this one goes on.

        It shares all cells that do not change from now on, so that it is made in microseconds for each megabyte. Other
        threads may read it as long as they like, without waiting. It is a map as any other: what is inserted into it
        changes nothing here.

        Returns
        -------
        OccupancyMap
            A map of the same kind.

        Raises
        ------
        ValueError
            For OctoMap.
        """
    @property
    def revision(self) -> Self:
        """A snapshot of the map as it is now, for `changes(since=...)` later."""
    def changes(
        self, *, since: OccupancyMap, of: ChangeOf = "states", box: ArrayLike | None = None
    ) -> Changes:
        """Regions that differ from an earlier state of the map, or from another map of the same cells.

        Takes time in proportion to what was written since the snapshot was made, whatever the size of the map. Any number
        of listeners may each keep a snapshot of their own; one holds at most the memory that the map held then.

        Parameters
        ----------
        since : OccupancyMap
            An earlier snapshot() or `revision` of this map, or any map of the same kind with cells of the same sizes.
        of : {"states", "columns", "cells"}
            Which differences count: of the state; the state as part of a column, where free cells that are `Leaves.thin` count
            as occupied, and occupied ones larger than the smallest are 2; or anything that a cell holds, as its probability, hits and misses, size, or values of its layers
            (which takes time in proportion to those of layers that changed).
        box : array_like, (2, dim), optional
            Only regions that share a volume with it; corners [m].

        Returns
        -------
        Changes
            Regions, free of overlaps; each lies in one cell of either map.

        Raises
        ------
        ValueError
            The maps are not of the same kind, their cells not of the same sizes, `of` is none of these, or `box` is no box.
        """
    def merge(self, other: OccupancyMap) -> None:
        """Add what another map of the same place knows.

        Evidence and counts of cells add up, as if this map had seen both (of paper and fixed maps the log-odds, clamped);
        where the cells of one are larger, each of the other's gets its part. What both come to does not depend on which is
        merged into which. To put maps of different frames together, move one first: see transformed().

        Parameters
        ----------
        other : OccupancyMap
            A map of the same kind, with cells of the same sizes.

        Raises
        ------
        ValueError
            They are not. The map is then unchanged.
        MemoryError
            The map would hold more than max_memory. It is then unchanged.
        """
    def adopt(self, other: OccupancyMap, box: ArrayLike | None = None) -> None:
        """Copy the cells of another map where this one is unknown.

        Every cell stays what it is, bit for bit: parts of space that were mapped apart, see insert(window=), become the map that
        one would have made. To add up the evidence of two maps of the same place, see merge().

        Parameters
        ----------
        other : OccupancyMap
            A map of the same kind, with cells of the same sizes.
        box : (2, dim) array of float, optional
            Lower and upper corner [m]: only cells in it are taken over, that is, in all cubes of `max_cell_size` (of a fixed
            map: all cells) that share a volume with it, and the counts of `stats` stay this map's. Default: all, and the
            counts add up.

        Raises
        ------
        ValueError
            The maps are not of the same kind, their cells not of the same sizes, the box has no volume, or both maps hold cells
            in a cube of `max_cell_size`; it is named. The map is then unchanged.
        MemoryError
            The map would hold more than max_memory. It is then unchanged.
        """
    def transformed(self, pose: ArrayLike) -> Self:
        """The map in another frame: moved by a rigid motion.

        A motion by right angles and whole cells of max_cell_size (of a fixed map: whole cells) moves every cell as it is, with
        what it carries, bit for bit, and keeps the counters; the identity gives a map of the same bytes. After any other,
        borders and surfaces are moved to the nearest smallest cell, by at most half its diagonal more than the motion; nothing
        is blurred, and nothing unknown becomes known.

        Parameters
        ----------
        pose : (dim + 1, dim + 1) array of float; or (3,) in 2-D, (7,) in 3-D
            Every point x of this map is at `pose * x` in the other: a homogeneous matrix; or x, y and yaw; or x, y, z and a
            quaternion qx, qy, qz, qw [m, rad].

        Returns
        -------
        OccupancyMap
            A map of the same kind and options.

        Raises
        ------
        ValueError
            The pose is not finite, its rotation mirrors or is none, the last row of its matrix is not 0, ..., 0, 1, or it moves
            cells to where the lattice of cells does not reach; or borders and surfaces would go through more than 2**24 of the
            smallest cells, and 16 more for each leaf.
        MemoryError
            The map, with what its cells carry, would hold more than max_memory.
        """
    def __eq__(self, other: object) -> bool: ...
    __hash__: ClassVar[None]  # type: ignore[assignment]
    def stats(self) -> MapStats:
        """Size of the map and what happened to it: a MapStats."""
    def to_bytes(self) -> bytes:
        """The bytes of the map's file; equal maps give equal bytes."""
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map's file, of the kind that the ending says; it appears whole or not at all.

        Parameters
        ----------
        path : str or os.PathLike
            .ndt, or no ending at all: a map of ours, which `load` reads. .bt and .ot: OctoMap's; an OctoMap
            writes its own .ot. .yaml, .pgm and .png: an image for map_server. .ply, .npz and others: see
            `ndtree.convert`, which takes options, too.

        Raises
        ------
        OSError
            The file cannot be written; FileExistsError where one of another kind is there, which stays.
        ValueError
            No format has this ending, or it cannot hold the map.
        ImportError
            The format needs a library that is not installed; it names the extra.
        """
    def _repr_html_(self) -> str: ...
    def _repr_png_(self) -> bytes | None: ...
    def save_octomap(self, path: str | os.PathLike[str], *, cell_size: float | None = None) -> None:
        """Write an OctoMap file of a 3-D map.

        With the map's own cell size that is exact; other cells follow from the map's as in to_grid(), so that thin
        walls stay. Unknown space stays unknown. The file appears whole or not at all.

        Parameters
        ----------
        path : str or os.PathLike
            Ends in .ot, with the log-odds of each cell, or in .bt, where cells are free or occupied and no more.
        cell_size : float, optional
            OctoMap's resolution [m]; left out, the map's smallest cell size.

        Raises
        ------
        ValueError
            The map is not 3-D, the name ends otherwise, or something known lies more than 32768 cells from 0.
        OSError
            The file cannot be written.
        """
    def save_map_server(
        self,
        path: str | os.PathLike[str],
        *,
        cell_size: float | None = None,
        height: tuple[float, float] | None = None,
        wall_depth: float | None = None,
    ) -> None:
        """Write a map for navigation, as ROS's map_server and nav2 read it: .yaml, and .pgm beside it.

        A pixel is occupied if some occupied cell overlaps it, else free if some free one does, else unknown. Free cells
        that hold something thin (`Leaves.thin`) are occupied, too, in a 2-D map if they touch no occupied pixel.

        Parameters
        ----------
        path : str or os.PathLike
            Ends in .yaml; the image has the same name with .pgm.
        cell_size : float, optional
            Edge of a pixel [m]; left out, the map's smallest cell size.
        height : (low, high), optional
            Only cells of a 3-D map that overlap low <= z < high [m]. Default: all.
        wall_depth : float, optional
            Of a map in which beams have ended: how far behind free space occupied cells larger than the smallest
            are drawn [m]; beyond they are unknown: the hits of a wall seen from afar scatter over several of
            them, one behind the other. Left out, all of each is drawn.

        Raises
        ------
        ValueError
            The map is not 2-D or 3-D, a value is out of bounds, or nothing is known there.
        OSError
            A file cannot be written.
        """
    def save_ply(self, path: str | os.PathLike[str], *, leaves: ArrayLike | None = None) -> None:
        """Write cells as points of a PLY file.

        Each has x, y, z of the cell's centre and its size [m], its probability and its state (-1 unknown, 0 free,
        1 occupied). In the plane, z is 0. The file appears whole or not at all.

        Parameters
        ----------
        path : str or os.PathLike
        leaves : (n,) array of bool, optional
            The leaves() to write. Default: the occupied ones.

        Raises
        ------
        ValueError
            The map is not 2-D or 3-D, or the mask has another length.
        OSError
            The file cannot be written.
        """

class Planner:
    """Paths of one body in a map, as it was at the last update().

    It keeps its results about free space for the next question, and looks only at changes again.
    Threads may share it; they are answered one at a time.

    Parameters
    ----------
    map : OccupancyMap
        2-D or 3-D, one of ndtree's own.
    body, clearance, unknown
        As for OccupancyMap.plan().

    Raises
    ------
    ValueError
        As OccupancyMap.plan().
    """

    def __init__(
        self,
        map: OccupancyMap,
        body: Shape,
        *,
        clearance: float = 0.0,
        unknown: Literal["blocked", "free"] | float = "blocked",
    ) -> None: ...
    def plan(
        self, start: ArrayLike, goal: ArrayLike, *, max_seconds: float | None = None, headings: int = 16
    ) -> Path:
        """As OccupancyMap.plan() of the map at the last update.

        Parameters
        ----------
        start, goal, max_seconds, headings
            As for OccupancyMap.plan().

        Returns
        -------
        Path
            True if one was found.

        Raises
        ------
        ValueError
            The body collides at the start or the goal, or an argument is wrong.
        KeyboardInterrupt
            Ctrl-C.
        """
    def ways(
        self, start: ArrayLike, goals: ArrayLike, *, max_seconds: float | None = None
    ) -> NDArray[np.float64]:
        """Lengths of short ways from one place to each of several, in one search.

        The search has no direction: ways may be other ones than those of plan(), a little longer or shorter. Metres in
        unknown space count as often as they cost.

        Parameters
        ----------
        start : (dim,) array of float
            Where the origin of the body is [m].
        goals : (n, dim) array of float
            Where it may go [m].
        max_seconds : float, optional
            Longest time of the search [s].

        Returns
        -------
        (n,) float64
            [m]; inf where there is no way, or the body collides; nan where the time was over before that was known.

        Raises
        ------
        ValueError
            The body collides at the start, an array has a wrong shape, or a goal is not finite.
        KeyboardInterrupt
            Ctrl-C.
        """
    def by_way(
        self, start: ArrayLike, frontiers: Iterable[Frontier], *, max_seconds: float | None = None
    ) -> list[tuple[Frontier, float]]:
        """Frontiers that the body can reach, in the order of the way to them.

        The way to a frontier is that to the nearest of its cells from whose centre the body meets no obstacle.
        Beside unknown space it fits nowhere where that is blocked: such a planner has no way to any frontier.

        Parameters
        ----------
        start : (dim,) array of float
            Where the origin of the body is [m].
        frontiers : iterable of Frontier
            As `OccupancyMap.frontiers` gives them.
        max_seconds : float, optional
            As for ways().

        Returns
        -------
        list of (Frontier, float)
            The nearest first, each with the length of the way to it [m]; of equally near ones, in their order.

        Raises
        ------
        ValueError
            The body collides at the start.
        KeyboardInterrupt
            Ctrl-C.
        """
    def update(self, map: OccupancyMap) -> bool:
        """Follow the map: afterwards paths are those of a planner made of the map as it is now.

        Parameters
        ----------
        map : OccupancyMap
            The map that the planner was made of, or a changed copy of it.

        Returns
        -------
        bool
            Whether the state of any cell has changed, or whether it holds something thin.

        Raises
        ------
        ValueError
            The map is of another kind, or its cells of other sizes.
        """
    def first_blocked(self, points: ArrayLike) -> int:
        """The first segment of a path in which the body, with its clearance, meets an obstacle.

        Parameters
        ----------
        points : (n, dim) array of float
            Points of a path, straight between them [m]; in the plane also (n, 3): poses of a body that turns the way that the
            numbers of its yaw go. One point alone is a segment.

        Returns
        -------
        int
            Number of the segment; -1 if the path is free.

        Raises
        ------
        ValueError
            A point is not finite, or a segment between poses both moves and turns.
        """
    def corridors(self, points: ArrayLike, *, reach: float = 1.0) -> list[NDArray[np.float64]]:
        """Convex free space along a path, as optimizers of trajectories take it.

        For each segment a set of places that contains it, so that neighbours share the point between them. From no place
        in a set does the body, with its clearance, overlap an obstacle: each is behind one of the planes as a whole, and
        if a plane was left out or moved out, one would not be. Planes are at right angles to the shortest ways from the
        body's sweep to obstacles, the nearest first.

        Parameters
        ----------
        points : (n, dim) array of float
            Points of a path, straight between them and free for the body [m].
        reach : float
            Length by which sets extend beyond the segment on each axis, > 0 [m].

        Returns
        -------
        list of (k, dim + 1) float64, n - 1 of them
            Half spaces a, b: normals of length 1, and offsets [m]. The places x with a @ x <= b for all of them.

        Raises
        ------
        ValueError
            The body meets an obstacle on the path: the message names the segment. An argument is wrong.
        KeyboardInterrupt
            Ctrl-C.
        """
    @property
    def memory_bytes(self) -> int:
        """Bytes held for free space, and by the last search."""

class FrontierSearch:
    """Frontiers that follow a map.

    Only changes since the last update() are looked at again. Threads may share it.

    Parameters
    ----------
    map : OccupancyMap
        One of ndtree's own.
    box : (2, dim) array of float, optional
        Lower and upper corner [m]: free cells that touch it count. Default: everywhere.

    Raises
    ------
    ValueError
        The map is an OctoMap, or the box has a wrong shape.
    """

    def __init__(self, map: OccupancyMap, box: ArrayLike | None = None) -> None: ...
    def update(self, map: OccupancyMap) -> None:
        """Follow the map: afterwards the frontiers are those of the map as it is now.

        Parameters
        ----------
        map : OccupancyMap
            The map that the search was made of, or a changed copy of it.

        Raises
        ------
        ValueError
            The map is of another kind, or its cells of other sizes.
        KeyboardInterrupt
            Ctrl-C: there are no frontiers then until the next update.
        """
    def frontiers(self, *, min_cells: float = 8.0) -> list[Frontier]:
        """As OccupancyMap.frontiers() of the map at the last update.

        Parameters
        ----------
        min_cells : float
            Frontiers with a border smaller than this many faces of smallest cells are left out.

        Returns
        -------
        list of Frontier
            The largest border first.
        """

class AdaptiveMap(OccupancyMap):
    """Occupancy map whose cells find their size while mapping.

    Parameters
    ----------
    dim : int
        Dimension of space: 2, 3 or 4.
    branching : int
        Children of a node along each axis: 2, 3 or 4 (in four dimensions 2).
    refinement : str
        "evidence": cells split where a beam ends behind a free way through them or hits and misses contradict each
        other, start with a part of their parents' evidence, and merge where little is lost by it. "paper": the rules of
        Einhorn, Schroeter and Gross (ICRA 2011), as published.
    layers : dict of str, optional
        Values of cells beside their occupancy, by a name: "mean" of a number a beam, "mean3" of three, as of a
        colour, "majority" of labels, whole numbers in [0, 65535], or "latest" of times [s]. See `insert`, `layer`.
    min_cell_size : float
        Edge of the smallest cells [m]; of all cells where they are fixed.
    max_cell_size : float
        Edge of the largest cells that are updated [m]; rounded down to min_cell_size * branching**k.
    range_sigma : float
        Standard deviation of a range [m]; by default refinement at least 3/5 of a smallest cell.
    range_sigma_quadratic : float
        Growth of that deviation with the squared range [1/m].
    probability_min : float
        Lowest probability that a single beam gives a cell.
    probability_max : float
        Highest probability that a single beam gives a cell.
    log_odds_min : float
        Lower bound of a cell's log-odds.
    log_odds_max : float
        Upper bound of a cell's log-odds.
    miss_given_occupied : float
        Fraction of beams that pass an occupied cell.
    hit_given_free : float
        Fraction of beams that end in a free cell.
    significance : float
        Confidence of the chi-square test that splits a cell ("paper").
    sample_beams : float
        Beams of a dense scan that a well observed cell samples, per smallest cell side by side in it ("evidence").
    evidence_half_life : float
        A cell's evidence halves in this many scans that observe it [scans]; 0: never ("evidence").
    covered_share : float
        Fraction of each part (quadrant, octant) to be seen until a cell is observed; 0: any beam ("evidence").
    beam_divergence : float
        Full angle of wide beams, as of sonar [rad]; 0: lines ("evidence").
    max_memory : float
        Most memory that a map may take [bytes]; 0: 3/4 of the machine's.

    Raises
    ------
    ValueError
        A value is out of bounds; the message names it and the limit.
    TypeError
        There is no such option, or the refinement does not read it.
    """

    def __init__(
        self,
        *,
        dim: int,
        branching: int = 2,
        refinement: Refinement = "evidence",
        layers: Mapping[str, str] | None = None,
        min_cell_size: float = ...,
        max_cell_size: float = ...,
        range_sigma: float = ...,
        range_sigma_quadratic: float = ...,
        probability_min: float = ...,
        probability_max: float = ...,
        log_odds_min: float = ...,
        log_odds_max: float = ...,
        miss_given_occupied: float = ...,
        hit_given_free: float = ...,
        significance: float = ...,
        sample_beams: float = ...,
        evidence_half_life: float = ...,
        covered_share: float = ...,
        beam_divergence: float = ...,
        max_memory: float = ...,
    ) -> None: ...
    def __copy__(self) -> Self: ...
    def __deepcopy__(self, memo: dict[int, Any]) -> Self: ...
    @overload
    def cell_size(self, points: Sequence[float]) -> float:
        """Edge of the leaf around each point.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) float64
            [m], unknown space included; nan outside the map.
        """
    @overload
    def cell_size(self, points: ArrayLike) -> NDArray[np.float64]: ...

class FixedMap(OccupancyMap):
    """The baseline: the same map with every cell of one size.

    Parameters
    ----------
    dim, branching, layers
        As for AdaptiveMap.
    min_cell_size, range_sigma, range_sigma_quadratic, probability_min, probability_max, log_odds_min, log_odds_max, max_memory : float
        As for AdaptiveMap; min_cell_size is the edge of every cell that a beam updates, and cell_size another name of it.
    """

    def __init__(
        self,
        *,
        dim: int,
        branching: int = 2,
        refinement: Literal["fixed"] = "fixed",
        layers: Mapping[str, str] | None = None,
        min_cell_size: float = ...,
        range_sigma: float = ...,
        range_sigma_quadratic: float = ...,
        probability_min: float = ...,
        probability_max: float = ...,
        log_odds_min: float = ...,
        log_odds_max: float = ...,
        max_memory: float = ...,
    ) -> None: ...
    def __copy__(self) -> Self: ...
    def __deepcopy__(self, memo: dict[int, Any]) -> Self: ...
    @overload
    def cell_size(self, points: Sequence[float]) -> float:
        """Edge of the leaf around each point.

        Parameters
        ----------
        points : (n, dim) array of float
            Map frame [m].

        Returns
        -------
        (n,) float64
            [m], unknown space included; nan outside the map.
        """
    @overload
    def cell_size(self, points: ArrayLike) -> NDArray[np.float64]: ...

class OctoMap(OccupancyMap):
    """OctoMap itself (liboctomap), with the calls of the other maps.

    save() writes OctoMap's own .ot file. `stats()` counts cells of `min_cell_size` as observed_leaves, before
    pruning, and those after as pruned_leaves. `leaves()` gives them as stored, without counts of hits.

    Parameters
    ----------
    dim : int
        3; or 2: scans then lie in the plane z = 0.
    insertion : str
        "ray": insertRay() for each beam. "scan": insertPointCloud(), which updates a cell once a scan; it takes
        one origin a scan. "scan_lazy": the same with lazy evaluation. "scan_discretized": the same, and of the
        beams that end in one cell, one counts.
    min_cell_size, probability_min, probability_max, log_odds_min, log_odds_max : float
        A miss and a hit add the log-odds of the probabilities, within the bounds of a cell's log-odds; cell_size is
        another name of min_cell_size.

    Raises
    ------
    ValueError
        A value is out of bounds; the message names it and the limit.
    """

    def __init__(
        self,
        *,
        dim: int = 3,
        insertion: Insertion = "ray",
        min_cell_size: float = ...,
        probability_min: float = ...,
        probability_max: float = ...,
        log_odds_min: float = ...,
        log_odds_max: float = ...,
    ) -> None: ...
    def __copy__(self) -> Self: ...
    def __deepcopy__(self, memo: dict[int, Any]) -> Self: ...

_ScanTuple = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], float]

class CarmenParser:
    """Turns FLASER and ROBOTLASER1 records of a CARMEN log into scans."""

    def __init__(self, *, max_range: float | None = None, field_of_view: float | None = None) -> None: ...
    def parse_line(self, line: str) -> _ScanTuple | None:
        """(endpoints (n, 2), origin (2,), returned (n,), stamp) of a laser record, else None; ValueError naming the line."""
    @property
    def field_of_view(self) -> tuple[float, str] | None:
        """Field of view of the last FLASER record [rad], and whether the option, a PARAM record, the number of beams or none of them says it; None before the first."""
    @property
    def line_number(self) -> int:
        """Lines read so far."""

class XyzParser2:
    """Collects scans from lines of plain text: origin, end point[, 0 or 1]."""

    def __init__(self) -> None: ...
    def parse_line(self, line: str) -> _ScanTuple | None:
        """The scan that ends because this line starts another, as a tuple; else None."""
    def finish(self) -> _ScanTuple | None:
        """The last scan, as a tuple; None if no beam is waiting."""
    @property
    def line_number(self) -> int:
        """Lines read so far."""

class XyzParser3:
    """Collects scans from lines of plain text: origin, end point[, 0 or 1]."""

    def __init__(self) -> None: ...
    def parse_line(self, line: str) -> _ScanTuple | None:
        """The scan that ends because this line starts another, as a tuple; else None."""
    def finish(self) -> _ScanTuple | None:
        """The last scan, as a tuple; None if no beam is waiting."""
    @property
    def line_number(self) -> int:
        """Lines read so far."""

class SimulatedLog2:
    """A simulated log, and the world that it measures."""

    @property
    def dim(self) -> int: ...
    def __len__(self) -> int: ...
    def scan(self, i: int) -> _ScanTuple:
        """(endpoints (n, dim), origin (dim,), returned (n,), stamp) of scan i; the same at each call."""
    def moved(self, i: int) -> NDArray[np.bool_]:
        """(n,) bool: whether each beam of scan i returned from something that moves."""
    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(n,) bool: whether each of the (n, dim) points is inside something."""
    def distance(
        self, origins: ArrayLike, directions: ArrayLike, *, max_range: float = ...
    ) -> NDArray[np.float64]:
        """(n,) metres from origins to the first surface along directions; nan where there is none."""

class SimulatedLog3:
    """A simulated log, and the world that it measures."""

    @property
    def dim(self) -> int: ...
    def __len__(self) -> int: ...
    def scan(self, i: int) -> _ScanTuple:
        """(endpoints (n, dim), origin (dim,), returned (n,), stamp) of scan i; the same at each call."""
    def moved(self, i: int) -> NDArray[np.bool_]:
        """(n,) bool: whether each beam of scan i returned from something that moves."""
    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(n,) bool: whether each of the (n, dim) points is inside something."""
    def distance(
        self, origins: ArrayLike, directions: ArrayLike, *, max_range: float = ...
    ) -> NDArray[np.float64]:
        """(n,) metres from origins to the first surface along directions; nan where there is none."""

def moved_points(points: ArrayLike, rotation: ArrayLike, position: ArrayLike) -> NDArray[np.float64]:
    """Points (n, 3) by a rotation (3, 3) and a position (3,) [m], (n, 3); not finite where they were not."""

def depth_points(
    image: ArrayLike, x: ArrayLike, y: ArrayLike, z: float, no_depth: Sequence[float]
) -> NDArray[np.float64]:
    """Points (k, 3) of the pixels of a depth image (rows, columns) that have a depth, row by row.

    Parameters
    ----------
    image : array_like, (rows, columns)
        Zero, negative and not finite values are no depth.
    x, y : array_like, (columns,) and (rows,)
        Coordinates of a point per value of the image [m].
    z : float
        The same.
    no_depth : sequence of float
        Further values that are no depth.
    """

def points_within(points: ArrayLike, origin: ArrayLike, distance: float) -> NDArray[np.int64]:
    """Positions of points (n, dim) nearer than a distance to an origin, (dim,), or each to its own, (n, dim) [m]."""

def pose_matrix(pose: ArrayLike, *, dim: int, name: str = "pose") -> NDArray[np.float64]:
    """A pose as a homogeneous matrix, checked as all are that maps are given.

    Parameters
    ----------
    pose : (dim + 1, dim + 1) array of float; or (3,) in 2-D, (7,) in 3-D
        As of `OccupancyMap.transformed`.
    dim : int
        2, 3 or 4.
    name : str
        Its name in errors.

    Returns
    -------
    (dim + 1, dim + 1) float64

    Raises
    ------
    ValueError
        As of `OccupancyMap.transformed`.
    """

def pose_range_sigma(
    points: ArrayLike,
    origin: ArrayLike,
    pose_covariance: ArrayLike,
    *,
    own: ArrayLike | None = None,
    range_sigma: float = ...,
    range_sigma_quadratic: float = ...,
) -> NDArray[np.float64] | None:
    """Standard deviations of a scan's beams whose pose is unsure.

    Parameters
    ----------
    points, origin, pose_covariance
        As of `OccupancyMap.insert`.
    own : (n,) array of float, optional
        `range_sigma` of the beams without the pose's part.
    range_sigma, range_sigma_quadratic : float
        Of all beams, where `own` is left out; as the options of maps.

    Returns
    -------
    (n,) float64, or None
        A map's `range_sigma`; `own` where the covariance is all zero.

    Raises
    ------
    ValueError
        A shape is wrong, or the covariance is not finite, symmetric and without negative eigenvalues.
    """

def solve_pose_graph(
    poses: ArrayLike,
    pairs: ArrayLike,
    measured: ArrayLike,
    information: ArrayLike,
    kernels: ArrayLike,
    *,
    iterations: int = 50,
) -> tuple[NDArray[np.float64], int, float, float]:
    """Poses in the plane that fit measurements between them best.

    Parameters
    ----------
    poses : (n, 3) array of float
        x, y and yaw to start from; the first stays.
    pairs : (m, 2) array
        Numbers of poses; a measurement is the second as seen from the first.
    measured : (m, 3) array of float
        x, y and yaw.
    information : (m, 3, 3) array of float
        Inverse covariances, in the first's frame.
    kernels : (m,) array of float
        Standard deviations from which on a measurement counts half and less; 0: it counts whatever it is.
    iterations : int
        At most.

    Returns
    -------
    poses : (n, 3) float64
    iterations : int
    before, after : float
        Sums of squared errors in standard deviations.
    """

@overload
def simulate(
    world: Literal["office"], *, seed: int = 1, scans: int | None = None, **options: Unpack[SimulationOptions]
) -> SimulatedLog2:
    """A simulated log: 'office', 'apartment' or 'street'; noise_scale, outlier_rate, no_return_rate,
    position_sigma, heading_sigma, yaw, people, doors and cars as in SimulationOptions.
    """

@overload
def simulate(
    world: Literal["apartment", "street"],
    *,
    seed: int = 1,
    scans: int | None = None,
    **options: Unpack[SimulationOptions],
) -> SimulatedLog3: ...
@overload
def simulate(
    world: World, *, seed: int = 1, scans: int | None = None, **options: Unpack[SimulationOptions]
) -> SimulatedLog2 | SimulatedLog3: ...
def load(path: str | os.PathLike[str]) -> AdaptiveMap | FixedMap:
    """Read a map that save() wrote, or an OctoMap file, .bt or .ot; the content says what it is.

    Parameters
    ----------
    path : str or os.PathLike

    Returns
    -------
    AdaptiveMap or FixedMap
        Of an OctoMap file as load_octomap() gives it, which takes options, too.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It is no such file, truncated, damaged, or of another version.
    """

def leaf_counts(m: OccupancyMap) -> list[tuple[float, int, int, int, int]]:
    """How many leaves of each edge length [m] were observed, and are free, occupied and disputed."""

def write_ply(
    path: str | os.PathLike[str],
    points: ArrayLike,
    *,
    size: ArrayLike,
    probability: ArrayLike,
    state: ArrayLike,
) -> None:
    """A PLY file as OccupancyMap.save_ply() writes it, of any cells: their centres and more."""

@overload
def load_octomap(
    path: str | os.PathLike[str], *, refinement: Refinement = "evidence", max_memory: float = 0.0
) -> AdaptiveMap:
    """Read an OctoMap file, .bt or .ot, into a map.

    Cells have the borders and states of the file's leaves. Log-odds are the file's with refinement "paper" and
    "fixed". With "evidence" a cell gets the least evidence that gives its log-odds, which is met within 0.008 from
    -4.6 to 5.9, and is the nearer bound outside. Leaves of a .bt file get the map's log_odds_min or log_odds_max.
    Colours of a ColorOcTree's .ot become the layer 'color' of the rule 'mean3', red, green and blue from 0 to 255.

    Parameters
    ----------
    path : str or os.PathLike
    refinement : {"evidence", "paper", "fixed"}
        Policy for scans inserted later. With "fixed" all cells are of the smallest size.
    max_memory : float
        As of AdaptiveMap: a file that needs more is refused [bytes].

    Returns
    -------
    AdaptiveMap or FixedMap
        With dim 3, branching 2, and the file's resolution as its smallest cell size.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It is not an OctoMap file, or damaged: what was found, and where.
    MemoryError
        The map would hold more than max_memory.
    """

@overload
def load_octomap(
    path: str | os.PathLike[str], *, refinement: Literal["fixed"], max_memory: float = 0.0
) -> FixedMap: ...
@overload
def from_grid(
    states: ArrayLike, lower: ArrayLike, cell_size: float, *, refinement: Refinement = "evidence"
) -> AdaptiveMap:
    """A map with the states of a dense array.

    The inverse of OccupancyMap.to_grid(). Free cells get the map's log_odds_min, occupied ones its log_odds_max.

    Parameters
    ----------
    states : 2-D or 3-D array of int
        -1 unknown, 0 free, 1 occupied; the first axis is x, the second y, the third z.
    lower : (dim,) array of float
        Lower corner of the first cell [m]: within a millionth of a cell of whole numbers of cells from 0.
    cell_size : float
        [m].
    refinement : {"evidence", "paper", "fixed"}
        Policy for scans inserted later. With the first two, equal neighbours are joined.

    Returns
    -------
    AdaptiveMap or FixedMap
        With branching 2.

    Raises
    ------
    ValueError
        A shape or a number is wrong, or the corner is not on the lattice of cells.
    """

@overload
def from_grid(
    states: ArrayLike, lower: ArrayLike, cell_size: float, *, refinement: Literal["fixed"]
) -> FixedMap: ...
def from_bytes(bytes: bytes) -> AdaptiveMap | FixedMap:
    """The map that to_bytes() wrote; ValueError as load()."""

def default_options() -> MapOptions:
    """dict of float: what maps use where nothing is said."""

def option_table() -> list[tuple[str, float, float, float, str, list[str], str | None, str, str]]:
    """The library's one table of options, and of the constants of the method.

    Returns
    -------
    list of tuple
        Name, default, least and largest value, unit with a blank before it, refinements of the maps that read it,
        what is typed behind a flag (None: a constant, which no map takes), what it is, and when to touch it.
    """

def is_held_out(i: int, held_out: int) -> bool:
    """Whether scan i, counted from 0, is held out: the last of every `held_out`; none if 0."""

def sample_step(scans: int) -> int:
    """Of the runs of `sample_run` scans that a log of this length has, each step-th is sampled.

    A power of two, so that the runs sampled of a longer log are among those of a shorter one. There are
    `sample_runs` of them to twice as many; fewer only in a short log.
    """

def sample_stride(beams: int) -> int:
    """Of a scan with this many beams, each stride-th is sampled."""

def may_be_sampled(scan: Scan) -> NDArray[np.bool_]:
    """(n,) bool: False for beams that begin or end absurdly far from the map's origin."""

def judge_no_returns(scans: Iterable[Scan]) -> NoReturns:
    """Decide from a sample of a log what its beams without return say."""
