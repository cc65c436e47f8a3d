"""The page of warnings lists every code with its sentence.

After an intended change run the test with ``PFWD_NEW_EXAMPLES=1``, which writes the table.
"""

import os
import re
from pathlib import Path

import pfwd  # noqa: F401  registers its warnings
from inversion.notices import fill_template, gaps_of, invalidated_by, templates

PAGE = Path(__file__).parents[1] / "docs" / "warnings.md"
TABLE = re.compile(
    r"\| code \| (?:no verdict by \| )?sentence, with its values in braces \|\n.*?(?=\n\n|\n\Z|\Z)",
    re.DOTALL,
)

FORBIDDEN = {"nothing": "", "fit": "fitted modulus", "record": "any value"}


def table() -> str:
    """Return the table of all codes, sorted."""
    lines = ["| code | no verdict by | sentence, with its values in braces |", "|---|---|---|"]
    for code, template in sorted(templates().items()):
        sentence = fill_template(template, {name: f"`{{{name}}}`" for name in gaps_of(template)})
        level = invalidated_by(code)
        lines.append(f"| `{code}` | {FORBIDDEN[level]} | {sentence.replace('``', '')} |")
    return "\n".join(lines)


def test_the_page_lists_every_warning() -> None:
    page = PAGE.read_text("utf-8")
    if os.environ.get("PFWD_NEW_EXAMPLES"):
        PAGE.write_text(TABLE.sub(lambda _: table(), page), "utf-8")
        page = PAGE.read_text("utf-8")
    assert table() in page, "run this test with PFWD_NEW_EXAMPLES=1 and look at the difference"
