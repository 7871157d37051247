# SPDX-License-Identifier: BSD-3-Clause
"""Files by name in a local folder, or wherever fsspec gets: each is there as a whole or not at all."""

from __future__ import annotations

import io
import os
import shutil
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from ndtree._lazy import install_of
from ndtree.base.files import replaced


class Storage(ABC):
    """A folder. Names have ``/`` between their parts.

    `url`: As it was given, for messages.
    """

    def __init__(self, url: str) -> None:
        self.url = url

    def place(self, name: str) -> str:
        """A file as messages call it."""
        return f"{self.url.rstrip('/')}/{name}"

    @abstractmethod
    def read(self, name: str) -> bytes:
        """The whole file. FileNotFoundError if there is none."""

    @abstractmethod
    def write(self, name: str, content: bytes) -> None:
        """Put a file in its place, at once; folders are made."""

    def array(self, name: str) -> NDArray[Any]:
        """The array of an npy file: mapped into memory where that is possible, else read."""
        return np.asarray(np.load(io.BytesIO(self.read(name)), allow_pickle=False))

    def write_array(self, name: str, values: NDArray[Any]) -> int:
        """Put an array into an npy file. @returns its bytes."""
        file = io.BytesIO()
        np.save(file, values, allow_pickle=False)
        content = file.getvalue()
        self.write(name, content)
        return len(content)

    @abstractmethod
    def names(self, folder: str) -> set[str]:
        """Names of all files in and below a folder, each with its folder; none if there is no such."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""

    @abstractmethod
    def remove_folder(self, name: str) -> None:
        """Remove a folder with all that is in it, if it is there."""

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        folder = name.rpartition("/")[0]
        return name in self.names(folder)


class LocalStorage(Storage):
    """A folder of this machine."""

    def __init__(self, url: str, folder: Path) -> None:
        super().__init__(url)
        self.folder = folder

    def read(self, name: str) -> bytes:
        return (self.folder / name).read_bytes()

    def write(self, name: str, content: bytes) -> None:
        target = self.folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        with replaced(target) as part:
            part.write_bytes(content)

    def array(self, name: str) -> NDArray[Any]:
        try:
            return np.load(self.folder / name, mmap_mode="r", allow_pickle=False).view(np.ndarray)
        except ValueError:  # Nothing can be mapped of an array without elements.
            return super().array(name)

    def names(self, folder: str) -> set[str]:
        return {
            path.relative_to(self.folder).as_posix()
            for path in (self.folder / folder).rglob("*")
            if path.is_file() and not path.name.startswith(".")
        }

    def remove(self, name: str) -> None:
        (self.folder / name).unlink(missing_ok=True)

    def remove_folder(self, name: str) -> None:
        shutil.rmtree(self.folder / name, ignore_errors=True)

    def has(self, name: str) -> bool:
        return (self.folder / name).is_file()


class RemoteStorage(Storage):
    """Whatever fsspec knows: object stores put a file in its place at once, as they are."""

    def __init__(self, url: str) -> None:
        super().__init__(url)
        try:
            import fsspec
        except ImportError:
            raise ImportError(
                f"{url}: fsspec is needed for what is not a local folder: {install_of('fleet')}"
            ) from None
        self._fs: Any
        self._fs, self._root = fsspec.core.url_to_fs(url)

    def _path(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}" if name else self._root

    def read(self, name: str) -> bytes:
        return bytes(self._fs.cat_file(self._path(name)))

    def write(self, name: str, content: bytes) -> None:
        path = self._path(name)
        self._fs.makedirs(path.rpartition("/")[0], exist_ok=True)
        self._fs.pipe_file(path, content)

    def names(self, folder: str) -> set[str]:
        self._fs.invalidate_cache()
        begin = len(self._fs._strip_protocol(self._path("")).rstrip("/")) + 1
        return {str(path)[begin:] for path in self._fs.find(self._path(folder))}

    def has(self, name: str) -> bool:
        path = self._path(name)
        self._fs.invalidate_cache(path.rpartition("/")[0])
        return bool(self._fs.exists(path))

    def remove(self, name: str) -> None:
        if self._fs.exists(self._path(name)):
            self._fs.rm_file(self._path(name))

    def remove_folder(self, name: str) -> None:
        if self._fs.exists(self._path(name)):
            self._fs.rm(self._path(name), recursive=True)


def storage_of(url: str | os.PathLike[str]) -> Storage:
    """Where a URL points to. A path, and ``file://``, is a local folder, which need not be there yet.

    Raises ImportError if it is something else, and fsspec, or what it needs for it, is not installed;
        ValueError if fsspec knows no such kind of place.
    """
    text = os.fspath(url)
    parts = urlsplit(text)
    if "://" not in text:
        return LocalStorage(text, Path(text))
    if parts.scheme == "file":
        return LocalStorage(text, Path(unquote(parts.path)))
    return RemoteStorage(text)
