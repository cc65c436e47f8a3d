"""Blind campaign: diagnose drops with undeclared effects, then compare with the true effects.

The trace files are made by `tests.campaigns.blind`: finite elements and operators in time, without
code of the inversion. They are diagnosed from their folder before the true values are read. Some
grounds have constant-Q damping or a modulus that grows with depth in place of Kelvin-Voigt soil.
With --short every kind has a few drops of random strength, which takes about ten minutes on two
cores.
"""

import argparse
import json
import math
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from benchmarks.output import Proportion, Reporter, parse_options
from tests.campaigns.blind import Case, make_campaign, read_truth
from tests.campaigns.effects.catalogue import EFFECTS

DiagnosisRecord = Mapping[str, Any]

# An effect matters if it changes the modulus or leaves a residual beyond these limits.
MODULUS_SHIFT, RESIDUAL_OVER_NOISE = 0.01, 3.0
GROUPS = ("clean", "known", "unknown", "soil")
CLIPPED = frozenset({"load-clipped", "sensor-clipped"})
"""Codes of warnings about clipped samples."""
NOISE_LEVELS = (5e-4, 2e-3, 5e-3)
CURVE_POINTS = 6


@dataclass(frozen=True)
class Judged:
    """True values and diagnosis of one point."""

    case: Case
    record: DiagnosisRecord | None
    """Diagnosis; None: the file was not valid."""

    @property
    def verdict(self) -> str:
        """Verdict of the diagnosis, or `refused`."""
        return "refused" if self.record is None else str(self.record["verdict"])

    @property
    def first(self) -> str:
        """Name of the strongest effect, `clean`, `unexplained` or `refused`."""
        effects = self.record["effects"] if self.record else []
        if self.verdict == "explained" and effects:
            return str(effects[0]["name"])
        return self.verdict

    @property
    def named(self) -> set[str]:
        """Names of the detected effects and of their alternatives."""
        names: set[str] = set()
        for effect in self.record["effects"] if self.record else []:
            names |= {effect["name"], *effect["alternatives"]}
        if self.record and self.record.get("rejected"):
            names.add("false_trigger")
        if self.record and any(
            warning["code"] in CLIPPED for warning in self.record["warning_codes"]
        ):
            names.add("saturation")
        return names

    def signed_error(self, when: str) -> float | None:
        """Return the relative error of the modulus before or after the diagnosis; None: no modulus.

        ``when`` is "before" or "after".
        """
        state = self.record[when] if self.record else None
        modulus = state["modulus_pa"] if state else None
        if modulus is None or math.isnan(modulus) or self.case.modulus_pa is None:
            return None  # a rig has no modulus
        return float(modulus) / self.case.modulus_pa - 1

    def error(self, when: str) -> float | None:
        """Return the absolute relative error of the modulus before or after the diagnosis.

        The result is None without a modulus.
        """
        signed = self.signed_error(when)
        return None if signed is None else abs(signed)

    @property
    def held(self) -> bool | None:
        """True if the 95 % interval after the diagnosis contains the true modulus.

        The value is None if the interval or the true modulus is missing.
        """
        interval = self._interval
        if interval is None or self.case.modulus_pa is None:
            return None
        return interval[0] <= self.case.modulus_pa <= interval[1]

    @property
    def lacks_modulus(self) -> bool:
        """True if the diagnosis reports no modulus."""
        after = self.record["after"] if self.record else None
        return after is None or after["modulus_pa"] is None

    @property
    def is_explained_wrongly(self) -> bool:
        """True if effects explain the record and the true one is not among them."""
        return self.verdict == "explained" and not self.right

    @property
    def half_width(self) -> float | None:
        """Half-width of the interval after the diagnosis, over the modulus."""
        interval = self._interval
        if interval is None or self.record is None:
            return None
        low, high = interval
        modulus = self.record["after"]["modulus_pa"] or math.sqrt(low * high)
        return 0.5 * (high - low) / float(modulus)

    @property
    def _interval(self) -> Sequence[float] | None:
        after = self.record["after"] if self.record else None
        interval = after.get("modulus_interval_pa") if after else None
        closed = interval is not None and all(e is not None and math.isfinite(e) for e in interval)
        return interval if closed else None

    @property
    def unexplained_or_held(self) -> bool:
        """True if the verdict is `unexplained` or `refused`, or the interval is right."""
        return self.verdict in ("unexplained", "refused") or bool(self.held)

    @property
    def visible(self) -> bool:
        """True if the residual of the base model is larger than noise."""
        before = self.record["before"] if self.record else None
        if before is None:
            return True  # no fit was possible
        residual = before["residual_over_noise"]
        return residual is not None and float(residual) > RESIDUAL_OVER_NOISE

    @property
    def matters(self) -> bool:
        """True if effect or noise changed the modulus by over 1 %, or it is visible."""
        shift = self.error("before")
        return self.visible or (shift is not None and shift > MODULUS_SHIFT)

    @property
    def right(self) -> bool:
        """True if the true effect is among the named ones."""
        return self.case.effect in self.named

    @property
    def alarmed(self) -> bool:
        """True if the verdict is not `clean`."""
        return self.verdict != "clean"


def run(arguments: list[str]) -> int:
    """Simulate, diagnose and compare a campaign.

    Return the exit status: 0, or 2 for wrong options.
    """
    kinds = f"groups ({', '.join(GROUPS)}) or effects by comma: {', '.join(EFFECTS)}"
    options, report = parse_options(
        "loop",
        __doc__,
        arguments,
        cases=(int, "drops per kind and strength (8), with --short per kind (4)"),
        short=(False, "draw the strengths; with --strengths take three"),
        strengths=(False, "detection by strength and noise"),
        kinds=(",".join(GROUPS), kinds),
        seed=(0, "random seed"),
        jobs=(2, "processes"),
        folder=(Path, "folder to keep the campaign in"),
    )
    words = set(options.kinds.split(","))
    unknown = words - set(EFFECTS) - set(GROUPS)
    if unknown:
        print(f"pfwd bench loop: no kind {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    options.kinds = {key for key, effect in EFFECTS.items() if words & {key, effect.group}}
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        if options.strengths:
            _strengths(report, options, folder)
        else:
            summarise(report, _campaign(report, options, folder))
    return 0


def _campaign(
    report: Reporter, options: argparse.Namespace, folder: Path, **choices: Any
) -> list[Judged]:
    """Simulate and diagnose one campaign."""
    begin = time.perf_counter()
    cache = user_cache_path("pfwd", appauthor=False) / "finite-elements"
    default_drops = 8 if not options.short else 2 if options.strengths else 4
    choices = {
        "per_case": options.cases or default_drops,
        "only": options.kinds,
        "drawn": options.short,
    } | choices
    cases = make_campaign(folder, seed=options.seed, cache=cache, **choices)
    built = time.perf_counter()
    files = sorted((folder / "traces").glob("*.csv"))
    records = diagnosed(files, options.jobs)
    with (folder / "diagnosed.jsonl").open("w", encoding="utf-8") as file:
        file.writelines(json.dumps(record) + "\n" for record in records.values())
    report.record(
        points=len(cases),
        drops=sum(case.drops for case in cases),
        build_s=built - begin,
        diagnosis_s=time.perf_counter() - built,
    )
    return [Judged(case, records.get(case.file)) for case in read_truth(folder)]


def diagnosed(files: Sequence[Path], jobs: int) -> dict[str, DiagnosisRecord]:
    """Return the diagnoses as JSON by file name; invalid files are omitted."""
    from pfwd.analysis.diagnosis.diagnose import diagnose_files
    from pfwd.analysis.diagnosis.entries import DiagnosisRequest

    request = DiagnosisRequest(jobs=jobs)
    diagnoses = diagnose_files([str(file) for file in files], request=request)
    return {Path(item.file).name: item.result.to_json() for item in diagnoses if item.result}


def summarise(report: Reporter, judged: Sequence[Judged]) -> None:
    """Print the results by point (JSON only), kind, strength and group, then totals."""
    if report.as_json:
        for point in judged:
            report.record(**_point(point))
    report.title("by kind: points, 95 % limits (Wilson); errors of the modulus in %")
    for key in sorted({point.case.key for point in judged}):
        part = [point for point in judged if point.case.key == key]
        report.record(kind=key, group=part[0].case.group, **_proportions(part))
    report.title("by group, the same")
    for name, part in grouped(judged).items():
        report.record(group_of_points=name, **_proportions(part))
    report.title("does the interval of the modulus after hold the truth (points)")
    for name, part in covered(judged).items():
        report.record(
            coverage=name,
            held=_held([point for point in part if not point.lacks_modulus]),
            half_width_median=_half_width(part),
            no_modulus=Proportion.among(part, lambda point: point.lacks_modulus),
            explained_wrongly=Proportion.among(part, lambda point: point.is_explained_wrongly),
        )
    report.title("true effect, and what was named first, where it matters or raised an alarm")
    for key in sorted({point.case.key for point in judged}):
        part = [
            point for point in judged if point.case.key == key and (point.matters or point.alarmed)
        ]
        if part:
            counts = Counter(point.first for point in part).most_common()
            report.record(true=key, named=", ".join(f"{name} {count}" for name, count in counts))


def _point(point: Judged) -> dict[str, Any]:
    """Return the facts of one point, so that two versions can be compared point by point."""
    return {
        "point": point.case.file,
        "true": point.case.key,
        "group": point.case.group,
        "soil": point.case.soil,
        "strength": point.case.strength,
        "drops": point.case.drops,
        "sensors": point.case.sensors,
        "true_modulus_pa": point.case.modulus_pa,
        "verdict": point.verdict,
        "named": ", ".join(sorted(point.named)),
        "right": point.right,
        "matters": point.matters,
        "before_error": point.signed_error("before"),
        "after_error": point.signed_error("after"),
        "held": point.held,
        "half_width": point.half_width,
    }


def grouped(judged: Sequence[Judged]) -> dict[str, list[Judged]]:
    """Return the points by group.

    Those on soil other than Kelvin-Voigt have groups of their own.
    """
    common = [point for point in judged if point.case.soil == "kelvin-voigt"]
    other_soil = [point for point in judged if point.case.soil != "kelvin-voigt"]
    parts = {
        "all": list(judged),
        "clean": _of_group(common, "clean"),
        "known effects": _of_group(common, "known"),
        "unknown effects": _of_group(common, "unknown"),
        "constant-Q soil alone": [
            p for p in _of_group(other_soil, "soil") if p.case.soil != "growth"
        ],
        "growth with depth alone": [
            p for p in _of_group(other_soil, "soil") if p.case.soil == "growth"
        ],
        "other soil, known effects": _of_group(other_soil, "known"),
        "other soil, unknown effects": _of_group(other_soil, "unknown"),
        "other soil, all": other_soil,
        "unknown effect or other soil": [*_of_group(common, "unknown"), *other_soil],
    }
    return {name: part for name, part in parts.items() if part}


def _of_group(judged: Sequence[Judged], group: str) -> list[Judged]:
    return [point for point in judged if point.case.group == group]


def _proportions(part: Sequence[Judged]) -> dict[str, Any]:
    """Return the figures of a kind or group; each point counts as one case."""
    return {
        "points": len(part),
        "drops": _drops(part),
        "right": Proportion.among([p for p in part if p.matters], lambda point: point.right),
        "unexplained": Proportion.among(part, lambda point: point.verdict == "unexplained"),
        "unexplained_or_held": Proportion.among(part, lambda point: point.unexplained_or_held),
        "alarmed": Proportion.among(part, lambda point: point.alarmed),
        "held": _held(part),
        "half_width_median": _half_width(part),
        **_errors(part),
    }


def _held(part: Sequence[Judged]) -> Proportion:
    return Proportion.among([p for p in part if p.held is not None], lambda point: bool(point.held))


def _half_width(part: Sequence[Judged]) -> float | None:
    """Return the median half-width of the intervals, % of the modulus; None: no intervals."""
    widths = [width for point in part if (width := point.half_width) is not None]
    return 100 * float(np.median(widths)) if widths else None


def covered(judged: Sequence[Judged]) -> dict[str, list[Judged]]:
    """Return the points with a true modulus in three groups.

    Soils and effects of the catalogue are known. An unknown effect is silent if it leaves no
    residual of the base model beyond the noise, as one that multiplies the record by a factor.
    """
    on_ground = [point for point in judged if point.case.modulus_pa is not None]
    unknown_effects = _of_group(on_ground, "unknown")
    return {
        "clean_and_known": [point for point in on_ground if point.case.group != "unknown"],
        "silent": [point for point in unknown_effects if not point.visible],
        "visible": [point for point in unknown_effects if point.visible],
    }


def _errors(part: Sequence[Judged]) -> dict[str, float | None]:
    """Return median and 90th percentile of the error of the modulus (%) before and after."""
    values: dict[str, float | None] = {}
    for when in ("before", "after"):
        errors = [error for point in part if (error := point.error(when)) is not None]
        weights = [point.case.drops for point in part if point.error(when) is not None]
        spread = np.repeat(errors, weights) if errors else None
        for name, rank in (("median", 50), ("p90", 90)):
            value = None if spread is None else 100 * float(np.percentile(spread, rank))
            values[f"{when}_{name}"] = value
    values["worse"] = _share(part, _worse)
    return values


def _worse(point: Judged) -> bool:
    before, after = point.error("before"), point.error("after")
    return before is not None and after is not None and after > before + MODULUS_SHIFT


def _drops(part: Iterable[Judged]) -> int:
    return sum(point.case.drops for point in part)


def _share(part: Sequence[Judged], holds: Callable[[Judged], bool]) -> float | None:
    """Return the fraction of the drops whose point meets a condition; None: no points."""
    return _drops(point for point in part if holds(point)) / _drops(part) if part else None


def _strengths(report: Reporter, options: argparse.Namespace, folder: Path) -> None:
    """Report how often each effect is named, by strength of the effect and noise."""
    points = 3 if options.short else CURVE_POINTS
    for noise in NOISE_LEVELS:
        judged = _campaign(
            report,
            options,
            folder / f"noise-{noise:g}",
            curve=points,
            noise=noise,
            drawn=False,
        )
        report.title(f"found by strength, noise {100 * noise:g} % of the peak")
        for key in EFFECTS:
            part = [point for point in judged if point.case.key == key]
            for level in sorted({point.case.level for point in part}):
                chosen = [point for point in part if point.case.level == level]
                right = (
                    _share(chosen, lambda point: point.right)
                    if EFFECTS[key].is_in_vocabulary
                    else _share(chosen, lambda point: point.verdict == "unexplained")
                )
                report.record(
                    effect=key,
                    noise=noise,
                    strength=chosen[0].case.strength,
                    drops=_drops(chosen),
                    found=right,
                    alarmed=_share(chosen, lambda point: point.alarmed),
                    before_median=_errors(chosen)["before_median"],
                    after_median=_errors(chosen)["after_median"],
                )
