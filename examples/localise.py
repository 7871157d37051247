# SPDX-License-Identifier: BSD-3-Clause
"""A robot that does not know where it is finds out by casting rays in a map: a particle filter."""

import argparse

import numpy as np

import ndtree
from ndtree import plot

ANGLES = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)  # Of the beams, in the robot's frame.
REACH, NOISE = 12.0, 0.2  # Of the scanner, and what is put up with, so that few particles do [m].


def beams(poses):
    """(n, beams, 2) origins and directions from poses (n, 3) of x, y and yaw."""
    angles = poses[:, 2:] + ANGLES
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    return np.broadcast_to(poses[:, None, :2], directions.shape), directions


def moved(poses, forward, left, turn):
    """Poses after moves in the robot's own frame."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses + np.column_stack((c * forward - s * left, s * forward + c * left, turn + 0.0 * c))


def drive(world, rng):
    """True poses along the log's way, and what the robot measures: its moves, and ranges (poses, beams)."""
    places = np.array([scan.origin for scan in world])
    ways = np.diff(places, axis=0, append=places[-1:])
    poses = np.column_stack((places, np.arctan2(ways[:, 1], ways[:, 0])))
    step, yaw = np.diff(places, axis=0, prepend=places[:1]), np.roll(poses[:, 2], 1)
    forward = np.cos(yaw) * step[:, 0] + np.sin(yaw) * step[:, 1]
    left = np.cos(yaw) * step[:, 1] - np.sin(yaw) * step[:, 0]
    moves = np.column_stack((forward, left, np.diff(poses[:, 2], prepend=poses[:1, 2])))
    ranges = np.nan_to_num(world.distance(*beams(poses), max_range=REACH), nan=REACH)
    return poses, moves * rng.normal(1.0, 0.03, moves.shape), ranges + rng.normal(0.0, 0.02, ranges.shape)


def localise(m, moves, ranges, rng, first=60_000, others=3_000):
    """Estimated poses, and the particles after each step; at first they are anywhere in free space."""
    anywhere = rng.uniform((*m.bounds()[0], -np.pi), (*m.bounds()[1], np.pi), (10 * first, 3))
    particles = anywhere[m.state(anywhere[:, :2]) == 0][:first]
    estimates, clouds = [], []
    for move, measured in zip(moves, ranges):
        spread = rng.normal(0.0, 1.0, (len(particles), 3)) * (0.02 + 0.05 * np.abs(move))
        particles = moved(particles, *(move + spread).T)
        expected = np.nan_to_num(m.cast_rays(*beams(particles), max_range=REACH), nan=REACH)
        misfit = np.minimum(np.abs(expected - measured) / NOISE, 3.0)  # People and chairs are no catastrophe.
        likelihood = np.cumsum(np.exp(-0.1 * (misfit**2).sum(axis=1)))
        at = (rng.random() + np.arange(others)) / others  # Systematic resampling.
        particles = particles[np.searchsorted(likelihood, at * likelihood[-1])]
        yaw = np.arctan2(np.sin(particles[:, 2]).mean(), np.cos(particles[:, 2]).mean())
        estimates.append([*particles[:, :2].mean(axis=0), yaw])
        clouds.append(particles)
    return np.array(estimates), clouds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", default="localise.png", help="file to draw the particles in")
    parser.add_argument("--steps", type=int, default=60, help="that the robot drives")
    arguments = parser.parse_args()
    rng, m = np.random.default_rng(2), ndtree.AdaptiveMap(dim=2, min_cell_size=0.05)
    for scan in ndtree.simulate("office"):
        scan.returned_only().insert_into(m, max_range=15.0)
    poses, moves, ranges = (a[: arguments.steps] for a in drive(ndtree.simulate("office", scans=360), rng))
    estimates, clouds = localise(m, moves, ranges, rng)
    errors = np.linalg.norm(estimates[:, :2] - poses[:, :2], axis=1)
    print(f"off by {errors[0]:.2f} m at first, by {errors[-1]:.3f} m after {len(errors)} steps")
    ax = plot.occupancy(m)
    for cloud, color in ((clouds[0], "tab:orange"), (clouds[-1], "tab:red")):
        ax.scatter(*cloud[:, :2].T, s=4.0, color=color, linewidths=0)
    ax.plot(*poses[:, :2].T, color="tab:blue", linewidth=1.0)
    ax.figure.savefig(arguments.picture, dpi=90, bbox_inches="tight")
