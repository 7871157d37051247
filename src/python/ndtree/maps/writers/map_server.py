# SPDX-License-Identifier: BSD-3-Clause
"""Images for ROS's map_server and nav2: PGM or PNG, and the YAML file about it."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

from ndtree._errors import Text, key
from ndtree._lazy import needs
from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced_together, require_kind


def noise_depth(m: OccupancyMap) -> float | None:
    """Two standard deviations of a range and a smallest cell: no wall is drawn thicker than its noise [m].

    None of a map that knows no noise.
    """
    if "range_sigma" not in m.options:
        return None
    return 2 * float(m.options["range_sigma"]) + float(m.options["min_cell_size"])


def write(
    m: OccupancyMap,
    path: Path,
    *,
    cell_size: float | None = None,
    height: tuple[float, float] | None = None,
    wall_depth: float | None = None,
) -> None:
    """See ``OccupancyMap.save_map_server()``; the image and the YAML file have the same name.

    `wall_depth`: Left out, `noise_depth`.
    """
    wall_depth = noise_depth(m) if wall_depth is None else wall_depth
    if m.dim == 3 and height is None:
        said = f"{key('height')} is not given: cells at all heights are drawn, the floor's too"
        warnings.warn(Text(said), stacklevel=4)
    yaml = path.with_suffix(".yaml")
    if path.suffix != ".png":
        require_kind(path.with_suffix(".pgm"))
        m.save_map_server(yaml, cell_size=cell_size, height=height, wall_depth=wall_depth)
        return
    with needs("PNG files need Pillow", "convert"):
        from PIL import Image
    with tempfile.TemporaryDirectory() as folder:
        same = Path(folder, "map.yaml")
        m.save_map_server(same, cell_size=cell_size, height=height, wall_depth=wall_depth)
        lines = same.read_text(encoding="utf-8").splitlines(keepends=True)
        lines[0] = "image: '{}'\n".format(path.name.replace("'", "''"))
        with replaced_together(path, yaml) as (png_part, yaml_part):
            with Image.open(same.with_suffix(".pgm")) as image:
                image.save(png_part)
            yaml_part.write_text("".join(lines), encoding="utf-8")
