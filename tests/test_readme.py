"""The Python of README and of docs/python.md runs as it stands and prints what stands below it.

After a change that is meant run the tests with ``PFWD_NEW_EXAMPLES=1``: what is printed is then
written into the pages. Look at the difference in git.
"""

import os
import re
from pathlib import Path

import pytest

from tests.documented import check_text, examples_of, run_examples

TOP = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/python.md")


@pytest.mark.parametrize("name", PAGES)
def test_the_examples_of_a_page_print_what_it_shows(name: str, tmp_path: Path) -> None:
    page = TOP / name
    examples = examples_of(page)
    printed = run_examples(examples, tmp_path)
    assert list(tmp_path.iterdir()) == []
    if os.environ.get("PFWD_NEW_EXAMPLES"):
        _write(page, printed)
        return
    for example, text in zip(examples, printed, strict=True):
        assert example.shown is not None
        check_text(text, example.shown)


def test_the_example_of_the_readme_finds_the_simulated_modulus(tmp_path: Path) -> None:
    (printed,) = run_examples(examples_of(TOP / "README.md"), tmp_path)
    found = re.search(r"^E = ([\d.]+) MPa, ([\d.]+) to ([\d.]+) MPa", printed, re.M)
    assert found is not None
    modulus, low, high = map(float, found.groups())
    # pfwd/scripting/data/README.md: 80 MPa were simulated.
    assert low <= 80.0 <= high
    assert modulus == pytest.approx(80.0, rel=0.01)


def test_a_page_that_shows_something_else_is_found() -> None:
    check_text("E 80.12 MPa\n", "E 80.1 MPa\n")
    for other in ("E 82.1 MPa\n", "E 80.1 kPa\n", "E 80.1 MPa 3\n"):
        with pytest.raises(AssertionError):
            check_text("E 80.12 MPa\n", other)


def _write(page: Path, printed: list[str]) -> None:
    texts = iter(printed)
    text = page.read_text(encoding="utf-8")
    pattern = r"(```python\n.*?```\n\n```text\n)(.*?)(```)"
    new = re.sub(pattern, lambda m: m[1] + next(texts) + m[3], text, flags=re.S)
    page.write_text(new, encoding="utf-8", newline="\n")
