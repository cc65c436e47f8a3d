"""Surrogates that several files share; building one takes seconds."""

import hashlib
from pathlib import Path

import pytest

import inversion
from inversion import SurrogateLibrary

# What a surrogate is computed by: a change of any of these makes the kept ones worthless.
_SOURCES = ("kernel", "contact", "rational", "laplace", "surrogate", "library")


@pytest.fixture(scope="session")
def library(
    pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory
) -> SurrogateLibrary:
    """Surrogates built by the code as it stands, kept from one run of the tests to the next."""
    package = Path(inversion.__file__).parent / "forward"
    digest = hashlib.sha256()
    for name in _SOURCES:
        digest.update((package / f"{name}.py").read_bytes())
    cache = getattr(pytestconfig, "cache", None)
    if cache is None:  # run without pytest's cache
        return SurrogateLibrary(tmp_path_factory.mktemp("surrogates"))
    return SurrogateLibrary(cache.mkdir("surrogates") / digest.hexdigest()[:16])
