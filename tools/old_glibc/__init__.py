# SPDX-License-Identifier: BSD-3-Clause
"""Links a module so that an older glibc than the one of this machine loads it.

A linker binds a function to the newest version of it that the C library defines, but the library keeps the
older ones. So it is given libraries without code, which define each function in the newest version up to the
one asked for; functions of later versions that headers and libstdc++ call are in ``later.c``. No other
compiler and no old system are needed.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

Version = tuple[int, ...]

#: Up to 2.33, these functions had libraries of their own; since then libc.so.6 has them in both versions.
_MOVED = Version((2, 34))
_LIBRARIES = {
    "libpthread.so.0": re.compile(r"_*(pthread|sem)_"),
    "libdl.so.2": re.compile(r"dl[a-z]"),
    "libc.so.6": re.compile(r""),
}


@dataclass(frozen=True)
class Symbol:
    """What a library defines: a function or, with its size in bytes, an object."""

    name: str
    version: str
    size: int | None = None


def parse_version(text: str) -> Version | None:
    """(2, 28) of GLIBC_2.28; None where it is not one of glibc's public versions."""
    found = re.fullmatch(r"GLIBC_(\d+(?:\.\d+)+)", text)
    return tuple(int(part) for part in found[1].split(".")) if found else None


def defined_symbols(listing: str) -> list[tuple[Symbol, bool]]:
    """Each symbol that is defined in what ``readelf --dyn-syms`` prints, and whether it is the default."""
    symbols = []
    for line in listing.splitlines():
        fields = line.split()
        if (
            len(fields) != 8
            or fields[6] == "UND"
            or fields[4] not in ("GLOBAL", "WEAK")
            or "@" not in fields[7]
        ):
            continue
        if fields[3] not in ("FUNC", "IFUNC", "OBJECT"):
            continue
        name, at, version = re.split("(@+)", fields[7])
        size = int(fields[2], 0) if fields[3] == "OBJECT" else None
        symbols.append((Symbol(name, version, size), at == "@@"))
    return symbols


def symbols_until(symbols: Iterable[tuple[Symbol, bool]], newest: Version) -> dict[str, list[Symbol]]:
    """By library: each symbol in its newest version that is not after `newest`."""
    chosen: dict[str, tuple[Version, Symbol]] = {}
    moved = set()
    for symbol, is_default in symbols:
        version = parse_version(symbol.version)
        if version is None:
            continue
        if version == _MOVED and is_default:
            moved.add(symbol.name)
        if version <= newest and (symbol.name not in chosen or version > chosen[symbol.name][0]):
            chosen[symbol.name] = (version, symbol)
    libraries: dict[str, list[Symbol]] = {name: [] for name in _LIBRARIES}
    for name, (_, symbol) in sorted(chosen.items()):
        library = "libc.so.6"
        if newest < _MOVED and name in moved:
            library = next(library for library, pattern in _LIBRARIES.items() if pattern.match(name))
        libraries[library].append(symbol)
    return libraries


def foreign_symbols(module: Path) -> list[str]:
    """Symbols of a Python module that neither Python nor a library defined when it was linked.

    They have no version, so no check of versions sees them; where they are missing the module does not load.
    """
    return sorted(_foreign(_readelf(str(module))))


def _foreign(listing: str) -> set[str]:
    undefined = (line.split() for line in listing.splitlines())
    names = {
        fields[7]
        for fields in undefined
        if len(fields) == 8 and fields[6] == "UND" and fields[4] == "GLOBAL" and "@" not in fields[7]
    }
    return {name for name in names if not re.match(r"_?Py", name)}


def _readelf(path: str) -> str:
    return subprocess.run(
        ["readelf", "--dyn-syms", "--wide", path],
        check=True, capture_output=True, text=True, env={"LC_ALL": "C", "PATH": "/usr/bin:/bin"},
    ).stdout  # fmt: skip


def _assembly(symbols: list[Symbol]) -> str:
    lines = []
    for symbol in symbols:
        kind = "function" if symbol.size is None else "object"
        lines += [
            f".section {'.text' if symbol.size is None else '.data'}",
            f".globl {symbol.name}",
            f".type {symbol.name}, %{kind}",
            f"{symbol.name}: .skip {symbol.size or 4}",
            f".size {symbol.name}, {symbol.size or 4}",
        ]
    return "\n".join([*lines, '.section .note.GNU-stack,"",%progbits', ""])


def _version_script(symbols: list[Symbol]) -> str:
    nodes: dict[str, list[str]] = {}
    for symbol in symbols:
        nodes.setdefault(symbol.version, []).append(symbol.name)
    return "".join(f"{version} {{ {'; '.join(names)}; }};\n" for version, names in nodes.items())


def _kind_of(library: Path) -> bytes:
    """Of which width and for which processor an ELF file is."""
    start = library.read_bytes()[:20]
    return start[4:6] + start[18:20]


class OldGlibc:
    """Libraries to link against in a folder, of the C compiler `cc`; see the module."""

    def __init__(self, folder: Path, newest: Version, cc: str = "cc") -> None:
        self._folder = folder
        self._cc = cc
        folder.mkdir(parents=True, exist_ok=True)
        found = symbols_until(self._defined_by("libc.so.6"), newest)
        found["libm.so.6"] = symbols_until(self._defined_by("libm.so.6"), newest)["libc.so.6"]
        for library, symbols in found.items():
            self._make_library(library, symbols)
        shared = " ".join(str(folder / name) for name in ("libc.so.6", "libpthread.so.0"))
        rest = self._path_of("libc_nonshared.a")
        loader = self._loader()
        (folder / "libc.so").write_text(f"GROUP ( {shared} {rest} AS_NEEDED ( {loader} ) )\n")
        self._run(
            "-O2", "-fPIC", "-fvisibility=hidden", "-Wall", "-std=c99", "-D_DEFAULT_SOURCE",
            "-c", str(Path(__file__).with_name("later.c")), "-o", str(folder / "later.o"),
        )  # fmt: skip

    def _loader(self) -> Path:
        """The machine's own dynamic loader, where there may be those of other processors, as of 32 bits."""
        own = _kind_of(Path(self._path_of("libc.so.6")))
        return next(path for path in sorted(Path("/").glob("lib*/ld-linux*.so.*")) if _kind_of(path) == own)

    @property
    def link_options(self) -> list[str]:
        """Those for a shared library in C++; its libstdc++ becomes part of it."""
        return [f"-L{self._folder}", str(self._folder / "later.o"), "-static-libstdc++"]

    def _make_library(self, soname: str, symbols: list[Symbol]) -> None:
        if not symbols:
            return
        base = self._folder / soname.split(".")[0]
        base.with_suffix(".s").write_text(_assembly(symbols))
        base.with_suffix(".map").write_text(_version_script(symbols))
        self._run(
            "-shared", "-nostdlib", f"-Wl,-soname,{soname}", f"-Wl,--version-script={base}.map",
            f"{base}.s", "-o", str(self._folder / soname),
        )  # fmt: skip
        if soname != "libc.so.6":  # The compiler is asked for -lm, and finds libc.so, above.
            link = base.with_suffix(".so")
            link.unlink(missing_ok=True)
            link.symlink_to(soname)

    def _defined_by(self, library: str) -> list[tuple[Symbol, bool]]:
        return defined_symbols(_readelf(self._path_of(library)))

    def _path_of(self, library: str) -> str:
        done = subprocess.run(
            [self._cc, f"-print-file-name={library}"], check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    def _run(self, *arguments: str) -> None:
        subprocess.run([self._cc, *arguments], check=True)
