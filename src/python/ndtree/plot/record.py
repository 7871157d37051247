# SPDX-License-Identifier: BSD-3-Clause
"""Films of a map that grows: a picture every few scans, as .mp4 by the program ffmpeg or as .gif."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from subprocess import CalledProcessError
from typing import TYPE_CHECKING, Any

import numpy as np

from ndtree import plot
from ndtree._errors import WrongValue
from ndtree._lazy import needs
from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.files import require_kind
from ndtree.cells.lattice import Cells, Floats
from ndtree.cells.regions import Track, found_region, picture_region

if TYPE_CHECKING:
    from ndtree.base.scan import Scan

with needs("ndtree.plot.record needs matplotlib", "plot"):
    from matplotlib.animation import FFMpegWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

ENDINGS = (".gif", ".mp4")
MAX_GIF_FRAMES = 300  # They are kept in memory.
SIZE = (1280, 720)  # Pixels.
FRAMES_A_SECOND = 15
_DPI = 100
_ROOM = 0.2  # By which what is shown grows beyond the map, so that it does not change at every frame.


class Recorder:
    """Draws a growing map every few scans into a film, which is there when it is closed, whole or not at all.

    `path`: The film to write; its ending, .mp4 or .gif, chooses the format.
    `every`: Scans from one picture to the next. A .gif of more than 300 pictures keeps every second, and then
        takes a picture half as often, so that memory does not grow with the log.
    `color`: Of the cubes of 3-D maps, as for `ndtree.plot.occupied`.
    Raises ValueError if the ending or `every` is not one of these; RuntimeError if there is no ffmpeg where
    it is needed.
    """

    def __init__(self, path: str | os.PathLike[str], *, every: int = 10, color: str = "height") -> None:
        self._path = Path(path)
        ending = self._path.suffix.lower()
        if ending not in ENDINGS:
            raise ValueError(f"{self._path}: the name of a film must end in {' or '.join(ENDINGS)}")
        if every < 1:
            raise WrongValue.of("every", every, ">= 1")
        if color not in plot.COLORS:
            raise ValueError(f"color = {color!r}: must be one of {', '.join(plot.COLORS)}")
        if ending == ".mp4" and not FFMpegWriter.isAvailable():
            raise RuntimeError(f"{self._path}: .mp4 needs the program ffmpeg on PATH; .gif does not")
        self._every, self._color = every, color
        self._figure = Figure(figsize=(SIZE[0] / _DPI, SIZE[1] / _DPI), dpi=_DPI)
        FigureCanvasAgg(self._figure)
        require_kind(self._path)
        self._file = _core.ReplacedFile(self._path)
        self._part = Path(self._file.temporary)
        self._film: Any = _Gif(self._part) if ending == ".gif" else _Mp4(self._part, self._figure)
        self._scans, self._last_drawn = 0, -1
        self._region: Floats | None = None
        self._track = Track()
        self.frames = 0

    def update(self, m: OccupancyMap, scan: Scan) -> None:
        """Take note of a scan that the map has just taken, and draw the map if it is time."""
        self._track.add(scan)
        self._scans += 1
        self._map = m
        if self._scans % (self._every * self._film.stride) == 0:
            self._draw(m)

    def close(self) -> None:
        """Draw the map as it is now, and put the film in its place.

        Raises ValueError if there was nothing to draw; OSError if ffmpeg fails, or the file cannot be
        written.
        """
        try:
            if self._scans and self._last_drawn != self._scans:
                self._draw(self._map)
            if not self.frames:
                raise ValueError(f"{self._path}: the map has no occupied cell, so that there is no film")
            try:
                self._film.finish()
            except CalledProcessError as error:
                raise OSError(f"{self._path}: ffmpeg ended with status {error.returncode}") from None
            _core.commit_together([self._file])
        finally:
            self.abandon()

    def abandon(self) -> None:
        """End without a film. Nothing happens after `close`."""
        self._film.abandon()
        self._file.discard()

    def _draw(self, m: OccupancyMap) -> None:
        if not m.stats().observed_leaves:
            return
        every = Cells.of(m)
        if not every.occupied.any():
            return
        region = picture_region(every, self._track.points) if m.dim == 2 else found_region(every)
        self._grow(np.asarray(region).reshape(-1, 2))
        assert self._region is not None
        self._figure.clear()
        ax = self._figure.add_axes((0.0, 0.0, 1.0, 0.94))
        track = np.array(self._track.points)
        if m.dim == 2:
            plot.occupancy(m, ax, region=self._region.ravel(), borders=isinstance(m, _core.AdaptiveMap))
        else:
            corners = plot.projected(np.stack(np.meshgrid(*self._region), axis=-1))
            low, high = corners.min(axis=0), corners.max(axis=0)
            pixel = float(np.max((high - low) / SIZE))
            try:
                shown = self._region.ravel()
                heights = (float(shown[4]), float(shown[5]))
                plot.occupied(m, ax, region=shown, color=self._color, heights=heights, finest=pixel)
            except ValueError:  # What is occupied is all above the ceiling that was found.
                return
            ax.set_xlim(low[0], high[0])
            ax.set_ylim(low[1], high[1])
            track = plot.projected(track)
        ax.set_axis_off()
        ax.plot(*track.T, color="#c81e78", linewidth=1.2)
        ax.plot(*track[-1], marker="o", color="#c81e78")
        self._figure.suptitle(f"scan {self._scans:,}: {np.count_nonzero(every.observed):,} cells", y=0.985)
        self._film.add(self._figure)
        self._last_drawn = self._scans
        self.frames += 1

    def _grow(self, region: Floats) -> None:
        """Show all of a region, with room around it where it was not shown before."""
        if self._region is None:
            self._region = region.copy()
        extent = float(np.max(region[:, 1] - region[:, 0]))
        low, high = region.T
        self._region[:, 0] = np.where(low < self._region[:, 0], low - _ROOM * extent, self._region[:, 0])
        self._region[:, 1] = np.where(high > self._region[:, 1], high + _ROOM * extent, self._region[:, 1])


class _Mp4:
    """Pictures go to ffmpeg one by one."""

    stride = 1

    def __init__(self, path: Path, figure: Figure) -> None:
        self._writer = FFMpegWriter(fps=FRAMES_A_SECOND, extra_args=["-pix_fmt", "yuv420p"])
        self._writer.setup(figure, str(path), dpi=_DPI)
        self._is_open = True

    def add(self, figure: Figure) -> None:
        self._writer.grab_frame()

    def finish(self) -> None:
        self._is_open = False
        self._writer.finish()

    def abandon(self) -> None:
        if self._is_open:
            self._is_open = False
            with contextlib.suppress(CalledProcessError, OSError):
                self._writer.finish()


class _Gif:
    """Pictures are kept, and every second is dropped when they are too many."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frames: list[Any] = []
        self.stride = 1  # Every n-th of the pictures asked for is taken.

    def add(self, figure: Figure) -> None:
        from PIL import Image

        canvas = figure.canvas
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3])
        self._frames.append(picture.quantize(128, dither=Image.Dither.NONE))
        if len(self._frames) > MAX_GIF_FRAMES:
            del self._frames[::2]
            self.stride *= 2

    def finish(self) -> None:
        first, *others = self._frames
        duration = round(1000 / FRAMES_A_SECOND)
        with open(self._path, "wb") as file:
            first.save(file, "GIF", save_all=True, append_images=others, duration=duration, loop=0)

    def abandon(self) -> None:
        self._frames.clear()
