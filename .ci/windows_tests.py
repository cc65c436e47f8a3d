"""Skip the tests that wine cannot pass, and print the table of results, for ``.ci/windows``.

As a plugin of pytest (``-p windows_tests``) it skips what windows_tests.txt lists, with reasons.
``python3 .ci/windows_tests.py FOLDER`` prints the table of the results (JUnit XML) in a folder.
"""

import sys
from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

LIST = Path(__file__).with_suffix(".txt")


def reasons_by_test() -> dict[str, str]:
    """Return the reason of each test in the list, by its name in pytest."""
    reasons: dict[str, str] = {}
    reason = ""
    for line in LIST.read_text(encoding="utf-8").splitlines():
        if line.startswith("#") or not line.strip():
            continue
        if line.startswith("tests/"):
            reasons[line.strip()] = reason
        else:
            reason = line.strip()
    return reasons


def pytest_collection_modifyitems(items: list[Any]) -> None:
    """Skip the tests of the list."""
    import pytest

    reasons = reasons_by_test()
    for item in items:
        reason = reasons.get(item.nodeid) or reasons.get(item.nodeid.partition("[")[0])
        if reason is not None:
            item.add_marker(pytest.mark.skip(reason=f"under wine: {reason}"))


def read_results(file: Path) -> tuple[Counter[str], Counter[str], list[str]]:
    """Return the counts of outcomes, the reasons of skipped tests and the names of failed ones."""
    counts, skipped, failed = Counter[str](), Counter[str](), list[str]()
    for case in ElementTree.parse(file).iter("testcase"):
        outcomes = {child.tag: child.get("message", "") for child in case}
        if "failure" in outcomes or "error" in outcomes:
            counts["failed"] += 1
            message = outcomes.get("failure") or outcomes.get("error") or ""
            first_line = (message.splitlines() or [""])[0]
            failed.append(f"{case.get('classname')}::{case.get('name')}: {first_line[:120]}")
        elif "skipped" in outcomes:
            counts["skipped"] += 1
            skipped[outcomes["skipped"]] += 1
        else:
            counts["passed"] += 1
    return counts, skipped, failed


def main(folder: Path) -> int:
    """Print one row per piece, then the failed tests, then the reasons of the skipped ones."""
    total, skipped, failed = Counter[str](), Counter[str](), list[str]()
    columns = ("passed", "failed", "skipped")
    print(f"{'tests':24}" + "".join(f"{name:>9}" for name in columns))
    for file in sorted(folder.glob("*.xml")):
        counts, reasons, names = read_results(file)
        print(f"{file.stem:24}" + "".join(f"{counts[name]:9}" for name in columns))
        total, skipped, failed = total + counts, skipped + reasons, failed + names
    print(f"{'all':24}" + "".join(f"{total[name]:9}" for name in columns))
    print(*(f"failed: {name}" for name in failed), sep="\n")
    print(*(f"skipped {number}: {reason}" for reason, number in skipped.most_common()), sep="\n")
    return 1 if failed or not total["passed"] else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
