"""Building of the response tables in inversion/forward/tables, which are part of the package."""

from pathlib import Path

from benchmarks.output import Reporter
from inversion import PlateProblem
from inversion.forward.growth import build_growth_surrogate
from inversion.forward.library import dump_table, growth_key, surrogate_key
from inversion.forward.surrogate_building import build_surrogate

_FOLDER = Path(__file__).resolve().parents[1] / "inversion" / "forward" / "tables"
_CENTRE = (0.0,)
# Tables for the centre sensor with usual Poisson's ratios, and for sensors at 2, 4 and 6 plate
# radii (0.3, 0.6 and 0.9 m for a plate of 0.15 m) with the default ratio. Others are built in a
# second.
_PROBLEMS = (
    *(PlateProblem("rigid-rough", nu, _CENTRE) for nu in (0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.49)),
    PlateProblem("rigid-rough", 0.35, (0.0, 2.0, 4.0)),
    PlateProblem("rigid-rough", 0.35, (0.0, 2.0, 4.0, 6.0)),
)
_CENTRE_PROBLEM = PlateProblem("rigid-rough", 0.35, _CENTRE)
_GROWTH_EXPONENTS = (0.5, 1.0)


def run(arguments: list[str]) -> int:
    """Write missing tables (all of them with ``--all``); return the exit status 0."""
    report = Reporter(arguments)
    _FOLDER.mkdir(exist_ok=True)
    problems = {f"{surrogate_key(problem, None)}.npz": problem for problem in _PROBLEMS}
    exponents = {
        f"{growth_key(_CENTRE_PROBLEM, exponent)}.npz": exponent for exponent in _GROWTH_EXPONENTS
    }
    for path in _FOLDER.glob("*.npz"):
        if path.name not in {*problems, *exponents} or "--all" in arguments:
            path.unlink()
    for name, problem in problems.items():
        path = _FOLDER / name
        if not path.exists():
            path.write_bytes(dump_table(build_surrogate(problem)))
            report.record(table=name, bytes=path.stat().st_size)
    for name, exponent in exponents.items():
        path = _FOLDER / name
        if not path.exists():
            path.write_bytes(dump_table(build_growth_surrogate(_CENTRE_PROBLEM, exponent)))
            report.record(table=name, bytes=path.stat().st_size)
    return 0
