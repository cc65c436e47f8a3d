"""Where surrogates come from: shipped tables, the cache on disk, or built on first use."""

from __future__ import annotations

import hashlib
import io
import logging
import os
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from platformdirs import user_cache_path

from inversion.forward.contact import PlateProblem
from inversion.forward.growth import GrowthSurrogate, build_growth_surrogate
from inversion.forward.surrogate import SHALLOWEST, Surrogate
from inversion.forward.surrogate_building import build_surrogate

_T = TypeVar("_T")
_LOG = logging.getLogger(__name__)

# Part of every key: a change of poles, nodes or samples makes old files useless, not wrong.
_FORMAT = 2
_SHIPPED = Path(__file__).parent / "tables"
# What numpy and zipfile raise on a file that is cut, flipped or of another kind.
_DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    RuntimeError,  # zipfile's, when a flipped bit names a compression or encryption of its own
    zipfile.BadZipFile,
    zlib.error,
)

# Told what is being built and how far it is, 0 to 1.
BuildProgress = Callable[[str, float], None]


class SurrogateLibrary:
    """Surrogates by plate, Poisson's ratio, offsets and depth.

    Parameters
    ----------
    folder : Path, optional
        Cache on disk; default: the platform's place for caches, or PFWD_CACHE.  A folder that
        cannot be read or written is survived: the surrogate is built again and a line is logged.
    progress : callable, optional
        Called while a surrogate is built.
    """

    def __init__(self, folder: Path | None = None, progress: BuildProgress | None = None) -> None:
        self._folder = folder or default_cache_folder()
        self._progress = progress
        self._kept: dict[str, Surrogate] = {}
        self._growth: dict[str, GrowthSurrogate] = {}

    def get(self, problem: PlateProblem, depth: float | None) -> Surrogate:
        """The surrogate for ``depth`` in plate radii (inf: half-space), or for all (None)."""
        for wanted in _candidates(problem, depth):
            key = surrogate_key(problem, wanted)
            found = self._kept.get(key) or self._read(key, lambda c: load_surrogate(c, problem))
            if found is not None:
                self._kept[key] = found
                return found
        distances = tuple(dict.fromkeys(problem.offsets))
        if len(distances) < len(problem.offsets):
            # Both sides of the plate: the ground answers alike, and one fit serves both.
            alike = self.get(replace(problem, offsets=distances), depth)
            key = surrogate_key(problem, depth)
            self._kept[key] = alike.at(problem.offsets)
            return self._kept[key]
        key = surrogate_key(problem, depth)
        built = self._build(problem, depth)
        self._kept[key] = built
        self._write(key, dump_surrogate(built))
        return built

    def growth(self, problem: PlateProblem, exponent: float) -> GrowthSurrogate:
        """The surrogate of ground whose modulus grows with depth; see `GrowthSurrogate`."""
        key = growth_key(problem, exponent)
        found = self._growth.get(key)
        if found is None:
            found = self._read(key, lambda content: load_growth(content, problem, exponent))
        if found is None:
            found = build_growth_surrogate(problem, exponent)
            self._write(key, dump_growth(found))
        self._growth[key] = found
        return found

    def _build(self, problem: PlateProblem, depth: float | None) -> Surrogate:
        what = f"{problem.plate} plate, Poisson's ratio {problem.poisson_ratio:g}"
        if len(problem.offsets) > 1:
            what += f", {len(problem.offsets)} sensors"
        what += ", all depths" if depth is None else ""
        tell = self._progress
        progress = None if tell is None else lambda fraction: tell(what, fraction)
        return build_surrogate(problem, depth, progress)

    def _read(self, key: str, load: Callable[[bytes], _T]) -> _T | None:
        for folder in (_SHIPPED, self._folder):
            path = folder / f"{key}.npz"
            try:
                if path.is_file():
                    return load(path.read_bytes())
            except _DAMAGE as error:
                _LOG.warning("surrogate cache %s cannot be read (%s); building again", path, error)
        return None

    def _write(self, key: str, content: bytes) -> None:
        path = self._folder / f"{key}.npz"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            # Under another name first: a reader never sees half a file.
            handle, temporary = tempfile.mkstemp(dir=self._folder, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(content)
                os.replace(temporary, path)
            except OSError:
                Path(temporary).unlink(missing_ok=True)
                raise
        except OSError as error:
            _LOG.warning("surrogate cache %s cannot be written (%s)", path, error)


def default_cache_folder() -> Path:
    """The folder of cached surrogates: PFWD_CACHE, or the platform's place for caches."""
    given = os.environ.get("PFWD_CACHE")
    return Path(given) if given else user_cache_path("pfwd", appauthor=False) / "surrogates"


def surrogate_key(problem: PlateProblem, depth: float | None) -> str:
    """File name (without ending) of a surrogate: readable, and unique to ten digits."""
    offsets = ",".join(f"{r:.10g}" for r in problem.offsets)
    where = "all" if depth is None else f"{depth:.10g}"
    text = f"{_FORMAT}|{problem.plate}|{problem.poisson_ratio:.10g}|{offsets}|{where}"
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    return f"{problem.plate}-{problem.poisson_ratio:.4g}-{digest}"


def growth_key(problem: PlateProblem, exponent: float) -> str:
    """File name (without ending) of a surrogate of growing ground."""
    return f"growth-{exponent:.10g}-{surrogate_key(problem, None)}"


def dump_surrogate(surrogate: Surrogate) -> bytes:
    """The surrogate as the bytes of an .npz file."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        half_space_poles=surrogate.half_space_poles,
        half_space_coefficients=surrogate.half_space_coefficients,
        echo_poles=surrogate.echo_poles,
        inverse_depths=surrogate.inverse_depths,
        echo_coefficients=surrogate.echo_coefficients,
    )
    return buffer.getvalue()


def load_surrogate(content: bytes, problem: PlateProblem) -> Surrogate:
    """The surrogate in the bytes of an .npz file.

    Raises
    ------
    ValueError, KeyError, zipfile.BadZipFile
        If the content is not one.
    """
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        parts = {name: data[name] for name in data.files}
    if parts["half_space_coefficients"].shape[0] != len(problem.offsets):
        raise ValueError("number of sensors differs")
    return Surrogate(problem, **parts)


def dump_growth(surrogate: GrowthSurrogate) -> bytes:
    """The surrogate of growing ground as the bytes of an .npz file."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        poles=surrogate.poles,
        coordinates=surrogate.coordinates,
        coefficients=surrogate.coefficients,
        stiffening=surrogate.stiffening,
    )
    return buffer.getvalue()


def load_growth(content: bytes, problem: PlateProblem, exponent: float) -> GrowthSurrogate:
    """The surrogate of growing ground in the bytes of an .npz file; as :func:`load_surrogate`."""
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        parts = {name: data[name] for name in data.files}
    if parts["coefficients"].shape[1] != len(problem.offsets):
        raise ValueError("number of sensors differs")
    return GrowthSurrogate(problem, exponent, **parts)


def _candidates(problem: PlateProblem, depth: float | None) -> list[float | None]:
    """Depths under which a fitting surrogate may be kept, best first."""
    if depth is None:
        return [None]
    # Offset sensors at one depth are better served by a fit of that depth alone.
    if depth >= SHALLOWEST and max(problem.offsets) <= 1.0:
        return [None, depth]
    return [depth, None] if depth >= SHALLOWEST else [depth]
