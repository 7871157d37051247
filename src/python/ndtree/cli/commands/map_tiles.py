# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree map -o FOLDER.tiles``: a log becomes a map in tiles, whatever fits into memory."""

import re
from pathlib import Path
from typing import Any, Optional

from ndtree._errors import WrongValue
from ndtree.base.exit_status import WrongCall
from ndtree.base.words import number_of
from ndtree.cli.commands.figures import counted
from ndtree.cli.commands.logs import length_of
from ndtree.cli.commands.mapping import Passage
from ndtree.cli.commands.messages import in_words, indented
from ndtree.cli.commands.progress import progress
from ndtree.logs import Log
from ndtree.maps.open import TILES_SUFFIX
from ndtree.tiles import TileMapper, open_tiles, storage_of
from ndtree.tiles.mapper import MAX_RESIDENT
from ndtree.tuning.config import Config

_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kMGT]?)(i?)B?")
_POWERS = {"": 0, "k": 1, "M": 2, "G": 3, "T": 4}


def is_tiled(output: Path) -> bool:
    """Whether a map with this name is one in tiles."""
    return output.suffix.lower() == TILES_SUFFIX


def bytes_of(flag: str, text: Optional[str]) -> int:
    """A size as people write it: 500MB, 2GiB, 1e9 is not one."""
    if text is None:
        return MAX_RESIDENT
    found = _SIZE.fullmatch(text.strip())
    if found is None:
        raise WrongCall(f"{flag} {text}: must be a number of bytes, as 500MB or 2GiB")
    return int(float(found[1]) * (1024 if found[3] else 1000) ** _POWERS[found[2]])


def map_into_tiles(
    log: Log, output: Path, config: Config, tile_size: Optional[float], max_resident: Optional[str]
) -> dict[str, Any]:
    """Map a log, or go on with what was killed. Returns figures."""
    limit = bytes_of("--max-resident", max_resident)
    target = config.new_map(log.dim)
    source = {"log": Path(log.name).name, "no_return": config.no_return, "max_range": str(config.max_range)}
    try:
        mapper = TileMapper(
            storage_of(output), target, tile_size=tile_size, max_resident=limit, made_from=source
        )
    except WrongValue as error:
        if error.option in ("tile_size", "max_resident"):
            raise WrongCall(in_words(error)) from None
        raise
    known = mapper.done
    passage = Passage(log, config)
    with progress() as advance:
        for _ in passage.into(
            lambda scan: mapper.insert(scan, max_range=config.max_range),
            is_final=lambda error: str(error).startswith(str(output)),  # Of the tiles, not of the scan.
        ):
            advance("mapping", passage.scans, length_of(log))
    report = passage.report(dict(mapper.counts))
    mapper.write(complete=True)
    tiles = open_tiles(str(output))
    return {
        "log": str(log.name),
        "scans": passage.scans,
        "known_scans": known,
        "beams": report,
        "seconds": mapper.seconds,
        "read_seconds": passage.read_seconds,
        "tiles": len(tiles.manifest.tiles),
        "tile_size": tiles.grid.size,
        "observed_leaves": tiles.observed_leaves,
        "bytes": sum(entry.bytes for entry in tiles.manifest.tiles.values()),
        "max_resident": limit,
    }


def print_tiled(figures: dict[str, Any], config: Config, output: Path) -> None:
    """What map_into_tiles() did."""
    known = f", {figures['known_scans']} of them known already" if figures["known_scans"] else ""
    print(f"{figures['log']}: {number_of(figures['scans'], 'scan')}{known}, {counted(figures['beams'])}")
    for line in config.notes:
        print(indented(line))
    print(
        f"  {number_of(figures['observed_leaves'], 'cell')} in {number_of(figures['tiles'], 'tile')} "
        f"of {figures['tile_size']:g} m, {figures['bytes'] / 1e6:.1f} MB"
    )
    print(f"read in {figures['read_seconds']:.3f} s, inserted in {figures['seconds']:.3f} s; wrote {output}")
