"""Library of surrogates, which are shipped as files, read from a cache, or built.

A surrogate is a fast approximation of the plate's compliance, see
:mod:`inversion.forward.surrogate`. Messages call it a response table.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from platformdirs import user_cache_path

from inversion.forward.contact import PlateProblem
from inversion.forward.growth import GrowthSurrogate, build_growth_surrogate
from inversion.forward.surrogate import MIN_DEPTH_RADII, Surrogate
from inversion.forward.surrogate_building import build_surrogate

_T = TypeVar("_T")
_LOG = logging.getLogger(__name__)

# Part of every key, so that files with other poles, nodes or samples are not read.
_FORMAT = 2
_SHIPPED = Path(__file__).parent / "tables"
# Errors of numpy and zipfile on a file that is truncated, damaged or of another kind.
_DAMAGED_FILE_ERRORS = (
    OSError,
    ValueError,
    TypeError,  # other arrays
    EOFError,
    RuntimeError,  # raised by zipfile if a damaged bit names an unknown compression or encryption
    zipfile.BadZipFile,
    zlib.error,
)

BuildProgress = Callable[[str, float], None]
"""Callback with a description of the surrogate being built and the fraction done, 0 to 1."""


class SurrogateLibrary:
    """Surrogates by plate, Poisson's ratio, offsets and bedrock depth, kept in memory.

    Parameters
    ----------
    folder : Path, optional
        Cache on disk; default: the environment variable PFWD_CACHE, or the platform's folder for
        caches. If the folder cannot be read or written, the surrogate is built again and a warning
        is logged.
    progress : callable, optional
        Called while a surrogate is built.
    max_surrogates : int, optional
        Largest number of surrogates in memory; with more, the oldest is dropped. Those of ground
        whose modulus grows with depth are not counted.
    """

    def __init__(
        self,
        folder: Path | None = None,
        progress: BuildProgress | None = None,
        max_surrogates: int | None = None,
    ) -> None:
        self._folder = folder or default_cache_folder()
        self._progress = progress
        self._max_surrogates = max_surrogates
        self._surrogates: dict[str, Surrogate] = {}
        self._growth_surrogates: dict[str, GrowthSurrogate] = {}

    def get(self, problem: PlateProblem, depth: float | None) -> Surrogate:
        """Return the surrogate for a bedrock depth, read or built if it is not in memory.

        Parameters
        ----------
        problem : PlateProblem
        depth : float, or None
            In plate radii; inf: half-space; None: a surrogate for all depths.
        """
        for candidate_depth in _candidates(problem, depth):
            key = surrogate_key(problem, candidate_depth)
            surrogate = self._surrogates.get(key) or self._read(key, partial(Surrogate, problem))
            if surrogate is not None:
                return self._remember(key, surrogate)
        distances = tuple(dict.fromkeys(problem.offsets))
        if len(distances) < len(problem.offsets):
            # Sensors on both sides of the plate at the same distance need one fit only.
            by_distance = self.get(replace(problem, offsets=distances), depth)
            return self._remember(surrogate_key(problem, depth), by_distance.at(problem.offsets))
        key = surrogate_key(problem, depth)
        surrogate = self._build(problem, depth)
        self._write(key, dump_table(surrogate))
        return self._remember(key, surrogate)

    def _remember(self, key: str, surrogate: Surrogate) -> Surrogate:
        self._surrogates[key] = surrogate
        if self._max_surrogates is not None and len(self._surrogates) > self._max_surrogates:
            del self._surrogates[next(iter(self._surrogates))]
        return surrogate

    def growth(self, problem: PlateProblem, exponent: float) -> GrowthSurrogate:
        """Return the surrogate of ground whose modulus grows with depth, see `GrowthSurrogate`."""
        key = growth_key(problem, exponent)
        surrogate = self._growth_surrogates.get(key)
        if surrogate is None:
            surrogate = self._read(key, partial(GrowthSurrogate, problem, exponent))
        if surrogate is None:
            surrogate = build_growth_surrogate(problem, exponent)
            self._write(key, dump_table(surrogate))
        self._growth_surrogates[key] = surrogate
        return surrogate

    def _build(self, problem: PlateProblem, depth: float | None) -> Surrogate:
        description = f"{problem.plate} plate, Poisson's ratio {problem.poisson_ratio:g}"
        if len(problem.offsets) > 1:
            description += f", {len(problem.offsets)} sensors"
        description += ", all depths" if depth is None else ""
        report = self._progress
        progress = None if report is None else lambda fraction: report(description, fraction)
        return build_surrogate(problem, depth, progress)

    def _read(self, key: str, build: Callable[..., _T]) -> _T | None:
        for folder in (_SHIPPED, self._folder):
            path = folder / f"{key}.npz"
            try:
                if path.is_file():
                    return build(**load_arrays(path.read_bytes()))
            except _DAMAGED_FILE_ERRORS as error:
                _LOG.warning(
                    "response table %s cannot be read (%s); it is built again", path, error
                )
        return None

    def _write(self, key: str, content: bytes) -> None:
        path = self._folder / f"{key}.npz"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            # Written under another name first, so that no reader sees an incomplete file.
            handle, temporary = tempfile.mkstemp(dir=self._folder, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(content)
                os.replace(temporary, path)
            except OSError:
                Path(temporary).unlink(missing_ok=True)
                raise
        except OSError as error:
            _LOG.warning(
                "response table %s cannot be written (%s); it is built each time", path, error
            )


def default_cache_folder() -> Path:
    """Return the folder of cached surrogates: PFWD_CACHE, or the platform's folder for caches."""
    folder = os.environ.get("PFWD_CACHE")
    return Path(folder) if folder else user_cache_path("pfwd", appauthor=False) / "surrogates"


def surrogate_key(problem: PlateProblem, depth: float | None) -> str:
    """Return the file name of a surrogate without its suffix.

    Inputs that differ within ten digits have different names.
    """
    offsets = ",".join(f"{r:.10g}" for r in problem.offsets)
    where = "all" if depth is None else f"{depth:.10g}"
    text = f"{_FORMAT}|{problem.plate}|{problem.poisson_ratio:.10g}|{offsets}|{where}"
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    return f"{problem.plate}-{problem.poisson_ratio:.4g}-{digest}"


def growth_key(problem: PlateProblem, exponent: float) -> str:
    """Return the file name, without suffix, of a surrogate of ground that stiffens with depth."""
    return f"growth-{exponent:.10g}-{surrogate_key(problem, None)}"


def dump_table(table: Surrogate | GrowthSurrogate) -> bytes:
    """Return the arrays of a response table as the bytes of an .npz file."""
    values = {field.name: getattr(table, field.name) for field in fields(table)}
    arrays: Any = {name: v for name, v in values.items() if isinstance(v, np.ndarray)}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def load_arrays(content: bytes) -> dict[str, Any]:
    """Return the arrays of a response table from the bytes of an .npz file."""
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def _candidates(problem: PlateProblem, depth: float | None) -> list[float | None]:
    """Return the depths for which a suitable surrogate may be stored, the most accurate first."""
    if depth is None:
        return [None]
    # For offset sensors a fit for the single depth is more accurate.
    if depth >= MIN_DEPTH_RADII and max(problem.offsets) <= 1.0:
        return [None, depth]
    return [depth, None] if depth >= MIN_DEPTH_RADII else [depth]
