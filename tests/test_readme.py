"""The Python of README and of docs/python.md runs and prints the text below it.

After an intended change run the tests with ``PFWD_NEW_EXAMPLES=1``: the output is then written
into the pages. Read the difference in git.
"""

import os
import re
from pathlib import Path

import pytest

from tests.documented import check_text, examples_of, run_examples

TOP = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/python.md")
SIMULATED_MPA = 80.0
"""True modulus of the example of README, see pfwd/scripting/data/README.md."""


@pytest.mark.parametrize("name", PAGES)
def test_the_examples_of_a_page_print_its_text(name: str, tmp_path: Path) -> None:
    page = TOP / name
    examples = examples_of(page)
    printed = run_examples(examples, tmp_path)
    assert list(tmp_path.iterdir()) == []
    if os.environ.get("PFWD_NEW_EXAMPLES"):
        _write(page, printed)
        return
    for example, text in zip(examples, printed, strict=True):
        assert example.expected is not None
        check_text(text, example.expected)
    if name == "README.md":
        match = re.search(r"^E = ([\d.]+) MPa, ([\d.]+) to ([\d.]+) MPa", printed[0], re.M)
        assert match is not None
        modulus, low, high = map(float, match.groups())
        assert low <= SIMULATED_MPA <= high
        assert modulus == pytest.approx(SIMULATED_MPA, rel=0.01)


def test_a_page_with_another_text_is_detected() -> None:
    check_text("E 80.12 MPa\n", "E 80.1 MPa\n")
    for different in ("E 82.1 MPa\n", "E 80.1 kPa\n", "E 80.1 MPa 3\n"):
        with pytest.raises(AssertionError):
            check_text("E 80.12 MPa\n", different)


def _write(page: Path, printed: list[str]) -> None:
    texts = iter(printed)
    text = page.read_text(encoding="utf-8")
    pattern = r"(```python\n.*?```\n\n```text\n)(.*?)(```)"
    new = re.sub(pattern, lambda m: m[1] + next(texts) + m[3], text, flags=re.S)
    page.write_text(new, encoding="utf-8", newline="\n")
