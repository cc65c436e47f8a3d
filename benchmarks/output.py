"""Output of the benchmarks as text or as JSON."""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from scipy.stats import binomtest

Item = TypeVar("Item")


@dataclass(frozen=True)
class Proportion:
    """Fraction of independent cases with its 95 % limits by Wilson."""

    count: int
    of: int

    @classmethod
    def among(cls, items: Sequence[Item], holds: Callable[[Item], bool]) -> "Proportion":
        """Return the fraction of the items that fulfil a condition."""
        return cls(sum(holds(item) for item in items), len(items))

    @property
    def share(self) -> float | None:
        """Fraction, 0 to 1; None: there are no cases."""
        return self.count / self.of if self.of else None

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper 95 % limit of the fraction, 0 to 1."""
        if not self.of:
            return 0.0, 1.0
        limits = binomtest(self.count, self.of).proportion_ci(method="wilson")
        return float(limits.low), float(limits.high)

    def __str__(self) -> str:
        if self.share is None:
            return "-"
        low, high = self.limits
        return f"{self.count}/{self.of} = {self.share:.0%} ({low:.0%} to {high:.0%})"

    def to_json(self) -> dict[str, float | None]:
        """Return counts, fraction and limits as values that JSON can hold."""
        low, high = self.limits
        return {"count": self.count, "of": self.of, "share": self.share, "low": low, "high": high}


class Reporter:
    """Printer of results, as text or with ``--json`` as one object per line."""

    def __init__(self, arguments: list[str]) -> None:
        self.as_json = "--json" in arguments

    def title(self, text: str) -> None:
        """Print a heading, except with ``--json``."""
        if not self.as_json:
            print(f"\n{text}\n{'-' * len(text)}", flush=True)

    def record(self, **values: Any) -> None:
        """Print one result; in text numbers have four significant digits."""
        if self.as_json:
            print(json.dumps({key: _as_json(value) for key, value in values.items()}), flush=True)
        else:
            print("  ".join(f"{key} {_short(value)}" for key, value in values.items()), flush=True)


def parse_options(
    part: str, description: str | None, arguments: list[str], /, **options: tuple[Any, str]
) -> tuple[argparse.Namespace, Reporter]:
    """Parse the arguments of a benchmark; return its options and the printer of its results.

    Parameters
    ----------
    part : str
        Name of the benchmark.
    description : str or None
        Text before the options in the help.
    arguments : list of str
    **options : (default, str)
        Default and help by name. A type in place of the default: no default. False: a flag. A
        tuple: the choices, the first of which is the default. ``paths``: one or more positional
        paths.
    """
    parser = argparse.ArgumentParser(prog=f"pfwd bench {part}", description=description)
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    for name, (default, text) in options.items():
        flag = f"--{name.replace('_', '-')}"
        match default:
            case _ if name == "paths":
                parser.add_argument(name, nargs="+", type=default, help=text)
            case False:
                parser.add_argument(flag, action="store_true", help=text)
            case type():
                parser.add_argument(flag, type=default, help=text)
            case tuple():
                parser.add_argument(flag, choices=default, default=default[0], help=text)
            case _:
                text = f"{text} (%(default)s)"
                parser.add_argument(flag, type=type(default), default=default, help=text)
    return parser.parse_args(arguments), Reporter(arguments)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _as_json(value: Any) -> Any:
    if isinstance(value, Proportion):
        return value.to_json()
    return value.item() if hasattr(value, "item") else value
