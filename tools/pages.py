# SPDX-License-Identifier: BSD-3-Clause
"""Tables and pictures of the pages, as tools measure and draw them."""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def write(file: str, **contents: str) -> None:
    """Put figures between their marks in a file."""
    text = (ROOT / file).read_text()
    for name, content in contents.items():
        pattern = re.compile(rf"(<!-- figures: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        if not pattern.search(text):
            sys.exit(f"{file} has no place for '{name}'")
        text = pattern.sub(lambda match, content=content: match[1] + content + match[2], text)
    (ROOT / file).write_text(text)


def reduced(path: Path) -> int:
    """Make a picture small by a palette, without dots; its bytes."""
    from PIL import Image

    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    return path.stat().st_size
