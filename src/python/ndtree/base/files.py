# SPDX-License-Identifier: BSD-3-Clause
"""Files that appear whole or not at all: what is around ``ndtree::ReplacedFile``, which says what is kept."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ndtree._native import _core


@contextmanager
def replaced(target: str | os.PathLike[str]) -> Iterator[Path]:
    """A hidden name with a file's ending, which takes the file's place when all went well.

    Raises
    ------
    OSError
        If the file cannot be written, or libraries that write it fail for whatever reason; it names the file.
    """
    with replaced_together(target) as (part,):
        yield part


@contextmanager
def replaced_together(*targets: str | os.PathLike[str]) -> Iterator[list[Path]]:
    """As `replaced`, of files that belong together; the one that names the others comes last."""
    files: list[_core.ReplacedFile] = []
    try:
        for target in targets:
            files.append(_core.ReplacedFile(target))
        parts = [Path(file.temporary) for file in files]
        try:
            yield parts
        except OSError as error:
            names = {os.fspath(part): os.fspath(target) for part, target in zip(parts, targets)}
            given = None if error.filename is None else os.fspath(error.filename)
            if given is not None and given not in names:
                raise
            name = os.fspath(targets[0]) if given is None else names[given]
            raise OSError(error.errno or errno.EIO, error.strerror or str(error), name) from error
        except (ImportError, MemoryError, TypeError, ValueError):
            raise
        except Exception as error:  # Of a library that has errors of its own for a disk that is full.
            said = " ".join(f"{type(error).__name__}: {error}".split())
            raise OSError(errno.EIO, f"cannot be written ({said[:200]})", os.fspath(targets[0])) from error
        _core.commit_together(files)
    finally:
        for file in files:
            file.discard()
