"""Number of tuned constants that decide about effects and warnings."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[3]
MODULES = (
    *(f"inversion/inference/{name}.py" for name in (
        "base", "selection", "state", "structures", "diagnose", "effect_results", "instrument",
        "modulus",
    )),
    *(f"inversion/diagnosis/{name}.py" for name in ("declarations", "findings")),
    *(f"pfwd/analysis/{name}.py" for name in ("diagnosis/shared_device", "results")),
)  # fmt: skip
# Steps of derivatives, tolerances and largest numbers of iterations, halves, quantiles, a normal
# distribution's deviation over its median one, the most layers of a request, the stress that moduli
# are compared at, the length of a name, the most neighbours of a point, and factors of units: none
# of them decides anything. Priors and bounds are those of the effects.
NO_DECISION = {
    "inversion/inference/selection.py": (8, 1e-2, 40.0),
    "inversion/inference/structures.py": (8,),
    "inversion/inference/diagnose.py": (12,),
    "pfwd/analysis/diagnosis/shared_device.py": (1.4826,),
    "inversion/inference/instrument.py": (50,),
    "inversion/inference/effect_results.py": (1e-3, 1e-6, 2e5, 3),
    "inversion/inference/modulus.py": (
        *(1.96, 9.0, 0.025, 0.975, 0.05, 1e-9, 1e-9, 1e-3, 20, 0.5, 0.5, 0.5),
    ),
    "inversion/inference/base.py": (4, 10.0, 30.0, 1e-6, 0.025, 0.025, 0.975),
    "inversion/inference/state.py": (100e3,),
    "pfwd/analysis/results.py": (1e6,),
}
MAX_NUMBERS = 31


def numbers_of(module: str) -> list[float]:
    """Return the numbers of a module but for 0, 1 and 2, and those that decide nothing."""
    tree = ast.parse((ROOT / module).read_text(encoding="utf-8"))
    result = [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, (int, float))
        and not isinstance(node.value, bool)
        and node.value not in (0, 1, 2)
    ]
    for number in NO_DECISION.get(module, ()):
        result.remove(number)
    return result


def test_the_number_of_tuned_constants_is_limited() -> None:
    numbers = {module: numbers_of(module) for module in MODULES}
    count = sum(map(len, numbers.values()))
    assert count <= MAX_NUMBERS, numbers
    # The count sees what is there.
    assert 5e-3 in numbers["inversion/inference/selection.py"]
