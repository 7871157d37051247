# SPDX-License-Identifier: BSD-3-Clause
"""What is tried: for each capability its judge, its worlds and its faults, and which of them a seed draws."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trial import living, maps, mounting, moving, planning, poses, sensing, setup, setup_in_space
from trial.outcome import Case, Outcome
from trial.robots import Recording
from trial.worlds import PLANAR, SPATIAL, WORLDS

_SPATIAL = tuple(make.__name__ for make in SPATIAL)
_PLANAR = tuple(make.__name__ for make in PLANAR)
_STANDING = ("street", "chamber", "storeys", "shelves", "passage", "flat", "bend", "ramp", "railing")
_MOVES = ("none", "person", "stood_and_left")
_ODOMETRY = ("none", "drift", "scale", "wrong_sign", "jump", "stall", "slip", "dropped", "no_odometry")


@dataclass(frozen=True)
class Capability:
    """One answer of the library.

    Attributes
    ----------
    judge : callable
    worlds, faults : tuple of str
    short : tuple of int
        Seeds of the short form: each world and each fault at least once, by sensors of few beams.
    """

    judge: Callable[[Case], tuple[Recording, Outcome]]
    worlds: tuple[str, ...]
    faults: tuple[str, ...]
    short: tuple[int, ...]


CAPABILITIES = {
    "map": Capability(
        maps.map_trial,
        (*_PLANAR, *_SPATIAL),
        _MOVES,
        (0, 4, 5, 9, 10, 13, 14, 22, 23, 24, 27, 28, 31, 33, 34, 35),
    ),
    "no_return": Capability(
        sensing.no_return_trial,
        ("room", "yard", "glass", "hall", "corridor", "twins"),
        ("none", "largest", "largest_noisy", "zero", "beyond", "dark"),
        (1, 3, 26, 28, 30, 35),
    ),
    "no_return_in_space": Capability(
        sensing.no_return_trial,
        ("street", "chamber", "flat", "bend", "passage", "shelves"),
        ("none", "nan", "zero", "largest", "largest_noisy", "beyond", "left_out", "dark_largest"),
        tuple(range(8)),
    ),
    "noise": Capability(
        sensing.noise_trial,
        ("room", "corridor", "hall", "loop", "flat", "ramp", "chamber"),
        ("none", "person"),
        (1, 2, 3, 12, 19, 20, 24),
    ),
    "setup": Capability(
        setup.setup_trial,
        ("room", "hall", "loop", "twins", "recesses"),
        (
            "none",
            "noisy",
            "late",
            "turned",
            "moved",
            "mirrored",
            "backwards",
            "scaled",
            "begins_at_0",
            "millimetres",
            "degrees",
        ),
        (0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 15),
    ),
    "setup_in_space": Capability(
        setup_in_space.setup_trial,
        ("street", "chamber", "bend", "flat", "shelves", "ramp", "railing"),
        (
            "none",
            "noisy",
            "turned",
            "tilted",
            "moved",
            "late",
            "scaled",
            "mirrored",
            "inverted",
            "wxyz",
            "camera_axes",
            "swept",
            "millimetres",
            "degrees",
        ),
        (0, 1, 3, 4, 5, 8, 9, 10, 11, 12, 13, 34, 35, 44),
    ),
    "poses_in_space": Capability(
        setup_in_space.setup_trial,
        ("street", "chamber", "bend", "shelves", "ramp", "railing"),
        ("none", "noisy", "shuffled", "jump", "carried", "seconds_late"),
        (0, 1, 2, 3, 4, 5, 6),
    ),
    "mount": Capability(
        mounting.mount_trial,
        ("room", "hall", "loop", "recesses", "street", "bend"),
        ("none", "noisy", "drift"),
        (0, 1, 2, 3, 4, 5),
    ),
    "align": Capability(poses.align_trial, _PLANAR, _ODOMETRY, (0, 15, 32, 36, 38, 39, 53, 61, 64, 67)),
    "align_in_space": Capability(poses.align_trial, _STANDING, _ODOMETRY, tuple(range(9))),
    "slam": Capability(poses.slam_trial, _PLANAR, _ODOMETRY, (1, 6, 9, 32, 43, 44, 57, 58, 60, 65)),
    "match": Capability(poses.match_trial, _PLANAR, ("near", "far"), (0, 4, 12, 29, 33, 34, 39, 44, 50, 54)),
    "match_in_space": Capability(poses.match_trial, _STANDING, ("near", "far"), (*range(9), 99)),
    "localize": Capability(
        poses.localize_trial,
        _PLANAR,
        ("none", "drift", "scale", "jump", "stall", "carried", "other_building"),
        (1, 2, 9, 24, 26, 28, 37, 50, 53, 55),
    ),
    "moved": Capability(
        moving.moved_trial,
        (*_PLANAR, *_SPATIAL),
        _MOVES,
        (1, 4, 9, 16, 21, 31, 39, 40, 46, 50, 57, 58, 59, 60, 65, 69),
    ),
    "localize_in_space": Capability(
        poses.localize_trial,
        _STANDING,
        ("none", "drift", "no_guess", "jump", "carried", "stall", "other_building"),
        tuple(range(9)),
    ),
    "clean": Capability(
        moving.clean_trial,
        ("corridor", "fence", "yard", "furniture", *_SPATIAL),
        (*_MOVES, "pitch"),
        (2, 7, 8, 10, 35, 42, 49, 51, 53, 57),
    ),
    "static": Capability(
        moving.static_trial,
        ("room", "corridor", "fence", "yard", "flat", "railing"),
        (*_MOVES, "pitch"),
        (1, 2, 6, 64, 66, 71),
    ),
    "live": Capability(
        living.live_trial,
        ("room", "corridor", "yard", "loop", "twins"),
        ("none", "late", "begins_late", "missing", "stamps_back", "largest"),
        (11, 22, 37, 38, 51, 54),
    ),
    "live_in_space": Capability(
        living.live_trial,
        ("street", "chamber", "flat", "ramp", "passage"),
        ("none", "late", "begins_late", "missing", "stamps_back", "largest"),
        (1, 0, 2, 3, 5, 4),
    ),
    "plan": Capability(
        planning.plan_trial,
        (*_PLANAR, *_SPATIAL),
        _MOVES,
        (1, 3, 21, 23, 24, 27, 28, 29, 31, 41, 42, 51, 53, 61, 63, 65),
    ),
    "grid": Capability(
        living.grid_trial, ("flat", "street", "shelves", "chamber"), ("none", "pitch"), (24, 27, 54, 55)
    ),
}


@dataclass(frozen=True)
class Trial:
    """What one seed draws; the same seed, the same trial."""

    capability: str
    world: str
    fault: str
    seed: int
    is_fixed: bool = False

    @classmethod
    def of(
        cls, name: str, seed: int, world: str | None = None, fault: str | None = None, is_fixed: bool = False
    ) -> Trial:
        """Worlds and faults take turns, until each pair has been tried."""
        one = CAPABILITIES[name]
        turns = seed // math.lcm(len(one.worlds), len(one.faults))
        return cls(
            name,
            world or one.worlds[(seed + turns) % len(one.worlds)],
            fault or one.faults[seed % len(one.faults)],
            seed,
            is_fixed,
        )

    def case(self) -> Case:
        """Where it takes place, and all else that the seed draws."""
        rng = np.random.default_rng([zlib.crc32(self.capability.encode()), self.seed])
        world = WORLDS[self.world](rng).placed(rng, 0.05)
        return Case(world, self.fault, rng, world.scene.dim, self.is_fixed)

    def run(self) -> tuple[Recording, Outcome]:
        return CAPABILITIES[self.capability].judge(self.case())

    def __str__(self) -> str:
        return f"{self.capability} --world {self.world} --fault {self.fault} --seed {self.seed}"
