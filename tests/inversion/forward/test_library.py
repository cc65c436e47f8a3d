"""Storage of surrogates; faults of the folder do not stop an inversion."""

from __future__ import annotations

import io
import logging
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inversion.forward import library as library_module
from inversion.forward.contact import PLATE_MODELS, PlateProblem
from inversion.forward.library import (
    SurrogateLibrary,
    default_cache_folder,
    dump_table,
    load_arrays,
    surrogate_key,
)
from inversion.forward.surrogate import MIN_DEPTH_RADII, Surrogate
from inversion.forward.surrogate_building import Progress, build_surrogate

CENTRE = PlateProblem("rigid-rough", 0.35)
THREE = PlateProblem("rigid-rough", 0.35, (0.0, 2.0, 4.0))


class Builder:
    """Stands for :func:`build_surrogate`: builds in no time and stores the requests."""

    def __init__(self) -> None:
        self.requests: list[tuple[PlateProblem, float | None]] = []

    def __call__(
        self, problem: PlateProblem, depth: float | None = None, progress: Progress | None = None
    ) -> Surrogate:
        self.requests.append((problem, depth))
        if progress is not None:
            progress(0.5)
            progress(1.0)
        sensors = len(problem.offsets)
        nodes = np.array([0.6, 0.3, 0.0]) if depth is None else np.array([1 / depth])
        return Surrogate(
            problem,
            np.array([-1 + 2j]),
            np.full((sensors, 2), float(len(self.requests))),
            np.array([-0.1 + 3j, -0.2 + 4j]),
            nodes,
            np.ones((nodes.size, sensors, 4)),
        )


@pytest.fixture
def shipped(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder in place of the tables that come with the program."""
    folder = tmp_path_factory.mktemp("tables")
    monkeypatch.setattr(library_module, "_SHIPPED", folder)
    return folder


@pytest.fixture
def builder(monkeypatch: pytest.MonkeyPatch, shipped: Path) -> Builder:
    """Builds in the library are counted and cost nothing; no tables come with the program."""
    made = Builder()
    monkeypatch.setattr(library_module, "build_surrogate", made)
    return made


def same(first: Surrogate, second: Surrogate) -> bool:
    """Return whether two surrogates hold the same numbers."""
    return first.problem == second.problem and dump_table(first) == dump_table(second)


# --- files ---------------------------------------------------------------------------------------


def test_a_surrogate_is_built_once_and_then_read(tmp_path: Path, builder: Builder) -> None:
    folder = tmp_path / "made" / "on" / "demand"
    first = SurrogateLibrary(folder)
    built = first.get(CENTRE, None)
    assert first.get(CENTRE, None) is built
    assert [path.suffix for path in folder.iterdir()] == [".npz"]
    read = SurrogateLibrary(folder).get(CENTRE, None)
    assert same(read, built)
    assert len(builder.requests) == 1


def test_a_table_of_growing_ground_is_built_once_and_then_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = SurrogateLibrary(tmp_path).growth(CENTRE, 1.0)
    monkeypatch.setattr(library_module, "_SHIPPED", tmp_path / "none")
    monkeypatch.setattr(library_module, "build_growth_surrogate", lambda *_: shipped)
    SurrogateLibrary(tmp_path).growth(CENTRE, 1.0)
    monkeypatch.setattr(library_module, "build_growth_surrogate", refuse)
    read = SurrogateLibrary(tmp_path).growth(CENTRE, 1.0)
    assert dump_table(read) == dump_table(shipped)


def test_a_bounded_library_drops_the_first_surrogate(tmp_path: Path, builder: Builder) -> None:
    library = SurrogateLibrary(tmp_path, max_surrogates=2)
    first, second, third = (library.get(THREE, depth) for depth in (5.0, 6.0, 7.0))
    assert library.get(THREE, 7.0) is third
    assert library.get(THREE, 6.0) is second
    repeated = library.get(THREE, 5.0)
    assert repeated is not first
    assert same(repeated, first)
    assert len(builder.requests) == 3


def test_two_sensors_at_equal_distance_share_a_fit(tmp_path: Path, builder: Builder) -> None:
    library = SurrogateLibrary(tmp_path)
    both = replace(CENTRE, offsets=(0.0, 2.0, 2.0, 4.0))
    result = library.get(both, None)
    assert [problem.offsets for problem, _ in builder.requests] == [(0.0, 2.0, 4.0)]
    assert result.problem == both
    assert result.half_space_coefficients.shape[0] == result.echo_coefficients.shape[1] == 4
    assert library.get(both, None) is result
    assert library.get(replace(both, offsets=(0.0, 2.0, 4.0)), None) is not result
    assert len(builder.requests) == 1


def test_sensors_on_both_sides_have_their_distances() -> None:
    built = build_surrogate(PlateProblem("averaged", 0.3, (0.0, 2.0, 4.0)), 20.0)
    p = np.array([[0.1 + 0.5j, 0.3 + 2j]])
    three = built.compliance(p, np.array([0.05]))
    four = built.at((0.0, 2.0, 2.0, 4.0)).compliance(p, np.array([0.05]))
    np.testing.assert_array_equal(four, three[:, [0, 1, 1, 2]])


def incomplete() -> bytes:
    """Return a file that lacks parts."""
    file = io.BytesIO()
    np.savez(file, half_space_poles=np.array([-1 + 2j]))
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"PK\x03\x04 no archive",
        b"\x93NUMPY",
        incomplete(),
        dump_table(Builder()(THREE)),
    ],
    ids=["no archive", "no array", "incomplete", "other sensors"],
)
def test_a_damaged_file_is_rebuilt(
    content: bytes, tmp_path: Path, builder: Builder, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / f"{surrogate_key(CENTRE, None)}.npz"
    path.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        surrogate = SurrogateLibrary(tmp_path).get(CENTRE, None)
    assert len(builder.requests) == 1
    assert "cannot be read" in caplog.text
    assert path.name in caplog.text
    # The damaged file has been replaced.
    assert same(SurrogateLibrary(tmp_path).get(CENTRE, None), surrogate)
    assert len(builder.requests) == 1


def test_a_truncated_or_flipped_file_is_rebuilt(tmp_path: Path, builder: Builder) -> None:
    SurrogateLibrary(tmp_path).get(CENTRE, None)
    path = tmp_path / f"{surrogate_key(CENTRE, None)}.npz"
    content = path.read_bytes()
    for length in range(0, len(content), len(content) // 12):
        path.write_bytes(content[:length])
        assert SurrogateLibrary(tmp_path).get(CENTRE, None).half_space_poles == [-1 + 2j]
    for place in range(0, len(content), len(content) // 40):
        flipped = bytearray(content)
        flipped[place] ^= 0xFF
        path.write_bytes(bytes(flipped))
        assert SurrogateLibrary(tmp_path).get(CENTRE, None).half_space_poles == [-1 + 2j]


def refuse(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("step", ["tempfile.mkstemp", "os.replace"])
def test_a_folder_that_cannot_be_written_is_survived(
    step: str,
    tmp_path: Path,
    builder: Builder,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(f"inversion.forward.library.{step}", refuse)
    with caplog.at_level(logging.WARNING):
        SurrogateLibrary(tmp_path).get(CENTRE, None)
    assert "cannot be written" in caplog.text
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_survived(tmp_path: Path, builder: Builder) -> None:
    occupied = tmp_path / "file"
    occupied.write_text("not a folder")
    library = SurrogateLibrary(occupied)
    built = library.get(CENTRE, None)
    assert library.get(CENTRE, None) is built
    assert len(builder.requests) == 1
    assert occupied.read_text() == "not a folder"


def test_the_folder_may_be_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PFWD_CACHE", str(tmp_path))
    assert default_cache_folder() == tmp_path
    monkeypatch.delenv("PFWD_CACHE")
    assert "pfwd" in default_cache_folder().parts


# --- which surrogate -----------------------------------------------------------------------------


def test_keys_differ_wherever_the_surrogate_does() -> None:
    problems = [
        PlateProblem(plate, ratio, offsets)
        for plate in PLATE_MODELS
        for ratio in (0.0, 0.35, 0.35 + 1e-9, 0.49)
        for offsets in ((0.0,), (0.0, 2.0), (0.0, 2.0 + 1e-9), (0.0, 2.0, 4.0), (0.0, 0.0))
    ]
    depths = (None, 1.6, 5.0, 5.0 + 1e-8, 60.0, math.inf)
    keys = {surrogate_key(problem, depth) for problem in problems for depth in depths}
    assert len(keys) == len(problems) * len(depths)
    assert all(key.isascii() and "/" not in key and len(key) < 60 for key in keys)


def test_a_centre_sensor_uses_the_tables_of_all_depths(tmp_path: Path, builder: Builder) -> None:
    library = SurrogateLibrary(tmp_path)
    every = library.get(CENTRE, None)
    assert library.get(CENTRE, 5.0) is every
    assert library.get(CENTRE, math.inf) is every
    # Shallower than they reach: on its own.
    library.get(CENTRE, 0.9 * MIN_DEPTH_RADII)
    assert [depth for _, depth in builder.requests] == [None, 0.9 * MIN_DEPTH_RADII]


def test_tables_of_the_program_come_first(tmp_path: Path, builder: Builder, shipped: Path) -> None:
    tables = builder(CENTRE, None)
    (shipped / f"{surrogate_key(CENTRE, None)}.npz").write_bytes(dump_table(tables))
    assert same(SurrogateLibrary(tmp_path).get(CENTRE, 5.0), tables)
    assert len(builder.requests) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_build_reports_its_progress(tmp_path: Path, builder: Builder) -> None:
    reports: list[tuple[str, float]] = []
    library = SurrogateLibrary(tmp_path, lambda what, fraction: reports.append((what, fraction)))
    library.get(THREE, None)
    assert [fraction for _, fraction in reports] == [0.5, 1.0]
    assert reports[0][0] == "rigid-rough plate, Poisson's ratio 0.35, 3 sensors, all depths"
    library.get(THREE, None)
    assert len(reports) == 2


# --- the tables of the program -------------------------------------------------------------------

SHIPPED = sorted(library_module._SHIPPED.glob("rigid-*.npz"))
LAYOUTS = ((0.0,), (0.0, 2.0, 4.0), (0.0, 2.0, 4.0, 6.0))


def problem_of(path: Path) -> PlateProblem:
    """The problem whose tables of all depths have this name."""
    (plate,) = (name for name in PLATE_MODELS if path.name.startswith(f"{name}-"))
    ratio = float(path.stem.removeprefix(f"{plate}-").split("-")[0])
    problems = (PlateProblem(plate, ratio, offsets) for offsets in LAYOUTS)
    (result,) = (problem for problem in problems if surrogate_key(problem, None) == path.stem)
    return result


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_tables_can_be_read(path: Path) -> None:
    surrogate = Surrogate(problem_of(path), **load_arrays(path.read_bytes()))
    assert surrogate.inverse_depths.size >= 20
    assert np.all(surrogate.half_space_poles.real < 0)
    assert np.all(surrogate.echo_poles.real < 0)


def test_tables_of_a_standard_plate_ship_with_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("nothing should be built")

    monkeypatch.setattr(library_module, "build_surrogate", refuse)
    library = SurrogateLibrary(tmp_path)
    for problem in (CENTRE, THREE):
        assert library.get(problem, None).inverse_depths.size >= 20
    assert library.get(CENTRE, math.inf) is library.get(CENTRE, 4.0)
    assert list(tmp_path.iterdir()) == []
