"""Builds the surrogates that ship with the package, into inversion/forward/tables."""

from pathlib import Path

from benchmarks.output import Reporter
from inversion import PlateProblem
from inversion.forward.growth import build_growth_surrogate
from inversion.forward.library import dump_growth, dump_surrogate, growth_key, surrogate_key
from inversion.forward.surrogate_building import build_surrogate, check_surrogate

_FOLDER = Path(__file__).resolve().parents[1] / "inversion" / "forward" / "tables"
_CENTRE = (0.0,)
# Poisson's ratios of the centre sensor, and the layouts with sensors at 2, 4 and 6 radii (0.3, 0.6
# and 0.9 m of the usual plate) for the usual ratio.  Any other table is built in a second.
_PROBLEMS = (
    *(PlateProblem("rigid-rough", nu, _CENTRE) for nu in (0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.49)),
    PlateProblem("rigid-rough", 0.35, (0.0, 2.0, 4.0)),
    PlateProblem("rigid-rough", 0.35, (0.0, 2.0, 4.0, 6.0)),
)


_USUAL = PlateProblem("rigid-rough", 0.35, _CENTRE)
_GROWTH_EXPONENTS = (0.5, 1.0)


def run(arguments: list[str]) -> int:
    """Write the tables that are missing (all of them with ``--all``); 0."""
    report = Reporter(arguments)
    _FOLDER.mkdir(exist_ok=True)
    wanted = {f"{surrogate_key(problem, None)}.npz": problem for problem in _PROBLEMS}
    growing = {f"{growth_key(_USUAL, exponent)}.npz": exponent for exponent in _GROWTH_EXPONENTS}
    for path in _FOLDER.glob("*.npz"):
        if path.name not in {*wanted, *growing} or "--all" in arguments:
            path.unlink()
    for name, problem in wanted.items():
        path = _FOLDER / name
        if not path.exists():
            surrogate = build_surrogate(problem)
            path.write_bytes(dump_surrogate(surrogate))
            report.record(table=name, largest_error=check_surrogate(surrogate))
    for name, exponent in growing.items():
        path = _FOLDER / name
        if not path.exists():
            path.write_bytes(dump_growth(build_growth_surrogate(_USUAL, exponent)))
            report.record(table=name, bytes=path.stat().st_size)
    return 0
