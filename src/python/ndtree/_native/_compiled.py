# SPDX-License-Identifier: BSD-3-Clause
"""What makes Python of the compiled module.

Its functions say what is wrong with a call, have a signature, and take and give arrays of any shape; its
results are plain objects.
"""

from __future__ import annotations

import functools
import os
import types
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from ndtree import _lazy
from ndtree._native import _core, results
from ndtree._native._arguments import TAKEN, flattened, refuse_masked, shaped
from ndtree._native._calls import error_of, refused, require_options, signature_of, text_of, warn_of_noise

#: By the compiled type of a result: the one that takes its place.
RESULTS: dict[type, type] = {
    getattr(_core, name): getattr(results, name) for name in results.__all__ if hasattr(_core, name)
}

#: What the package keeps to itself. All else are names of ``ndtree``, and pickles say so, wherever they lie.
INTERNAL = frozenset(
    "CarmenParser NoReturns ReplacedFile SimulatedLog2 SimulatedLog3 XyzParser2 XyzParser3 commit_together "
    "depth_points is_held_out judge_no_returns leaf_counts may_be_sampled most_cells moved_points "
    "option_table points_within pose_matrix pose_range_sigma reach_sigmas sample_run sample_runs sample_step "
    "sample_stride simulate solve_pose_graph thinnest_surface write_ply".split()
)

#: Constructors whose dimension has no default: a map of the wrong one refuses the first scan, far from here.
ASK_FOR_DIM = frozenset(("AdaptiveMap.__init__", "FixedMap.__init__", "ScanHistory.__init__"))


def complete(module: types.ModuleType) -> None:
    """Wrap every function and method, and put the results of Python's in the place of the compiled ones."""
    for raw, made in RESULTS.items():
        setattr(module, raw.__name__, made)
    options = _constructor_options(module)
    for name, held in list(vars(module).items()):
        if isinstance(held, type) and held.__module__ == module.__name__:
            held.__reduce_ex__ = _reduce  # type: ignore[method-assign, assignment]
            for member, method in list(vars(held).items()):
                is_own = member == "__init__" or not member.startswith("__")
                if is_own and _is_compiled(method):
                    keywords = options.get(name) if member == "__init__" else None
                    made = _wrapped(method, f"{name}.{member}", keywords, is_method=True)
                    has_none = member == "__init__" and signature_of(method.__doc__) is None
                    setattr(held, member, _refusing(name, held) if has_none else made)
        elif _is_compiled(held) and not name.startswith("__"):
            setattr(module, name, _wrapped(held, name, None, is_method=False))
    for name, held in vars(module).items():
        if isinstance(held, (type, types.FunctionType)) and name not in INTERNAL:
            held.__module__ = "ndtree"


def _refusing(name: str, held: type) -> Callable[..., None]:
    """The constructor of a class that has none."""

    def init(self: Any, *_: Any, **__: Any) -> None:
        kinds = " or ".join(one.__name__ for one in held.__subclasses__()) or "what calls give"
        raise TypeError(f"{name}(): has no constructor, expected {kinds}")

    return init


def _reduce(self: Any, protocol: int) -> Any:
    """Protocols 0 and 1 would make an object of pybind11's own base class, which ends the process."""
    return object.__reduce_ex__(self, max(protocol, 2))


def _constructor_options(module: Any) -> dict[str, dict[str, float]]:
    """Keywords of the maps' constructors that pybind11 knows as ``**kwargs`` alone, with their defaults."""
    kinds = {"AdaptiveMap": {"evidence", "paper"}, "ScanHistory": {"evidence"}, "FixedMap": {"fixed"}}
    kinds["OctoMap"] = {"octomap"}
    rows = [row for row in module.option_table() if row[6] is not None]
    return {
        name: {row[0]: row[1] for row in rows if refinements & set(row[5])}
        for name, refinements in kinds.items()
    }


def _is_compiled(held: Any) -> bool:
    return callable(held) and not isinstance(held, (type, types.FunctionType)) and bool(held.__doc__)


def _wrapped(
    function: Any, name: str, options: Mapping[str, object] | None, *, is_method: bool
) -> Callable[..., Any]:
    signature = signature_of(function.__doc__, options)
    asks_for_dim = signature is not None and name in ASK_FOR_DIM
    parameters = list(signature.parameters.values()) if signature is not None else []
    if signature is not None and asks_for_dim:
        parameters = [one.replace(default=one.empty) if one.name == "dim" else one for one in parameters]
        signature = signature.replace(parameters=parameters)
    parameters = parameters[is_method:]
    names = tuple(one.name for one in parameters)
    class_name, _, short = name.rpartition(".")
    called = class_name if short == "__init__" else short
    axes = TAKEN.get(name, TAKEN.get(short)) if is_method else None
    takes_path = "path" in names
    writes = takes_path and short.startswith(("save", "write"))

    @functools.wraps(function)
    def call(*arguments: Any, **keywords: Any) -> Any:
        if takes_path:
            arguments = tuple(_path_as_text(value) for value in arguments)
            keywords = {key: _path_as_text(value) for key, value in keywords.items()}
        given = {**dict(zip(names, arguments[is_method:])), **keywords}
        refuse_masked(short, given)
        if writes and isinstance(given.get("path"), str):
            _lazy.method("require_kind")(given["path"])
        if options is not None:
            require_options(class_name, keywords, names)
            largest = keywords.get("max_cell_size", options.get("max_cell_size"))
            warn_of_noise(keywords.get("range_sigma"), largest)
            if asks_for_dim and "dim" not in keywords and len(arguments) == 1:
                raise TypeError(f"{class_name}(): dim is missing, expected dim=2 or dim=3, as the points are")
        leading = None
        if axes is not None and arguments and len(given) == len(arguments) - is_method + len(keywords):
            held = arguments[0]
            changed, leading = flattened(
                axes, given, lambda: int(held.dim if hasattr(held, "dim") else len(held.lower))
            )
        try:
            if leading is None:
                return _plain(function(*arguments, **keywords))
            return shaped(_plain(function(arguments[0], **changed)), leading)
        except TypeError as error:
            said = str(error)
            if "): incompatible " not in said and "Unable to cast" not in said:  # pybind11's own.
                if "\n" not in said:
                    raise
                raise TypeError(" ".join(said.split())) from error.__cause__
            wrong = error_of(called, parameters, arguments[is_method:], keywords)
        except AttributeError:  # Of what is in an argument, which Python's own code in the module asks.
            found = refused(called, parameters, given)
            if found is None:
                raise
            wrong = found
        raise wrong

    call.__qualname__ = name  # pybind11's own is that of a class of its.
    call.__doc__ = text_of(function.__doc__)
    if signature is not None:
        call.__signature__ = signature  # type: ignore[attr-defined]
        del call.__wrapped__  # type: ignore[attr-defined]  # Its signature is unknown.
    return call


def _path_as_text(value: Any) -> Any:
    """pybind11 takes an interrupt that comes while a path says its text for an argument of the wrong kind."""
    return os.fspath(value) if hasattr(type(value), "__fspath__") else value


def _plain(result: Any) -> Any:
    """A compiled result, or a list of them, as Python's."""
    if type(result) is list:
        return [_plain(one) for one in result]
    made = RESULTS.get(type(result))
    return result if made is None else made(**{f.name: getattr(result, f.name) for f in fields(made)})


complete(_core)
