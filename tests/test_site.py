"""What the site is made from: every page has a place in it, every link leads somewhere.

The site itself is built strictly by ``python3 dev.py docs``.
"""

import re
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[1]
DOCS = TOP / "docs"
SETTINGS = (TOP / "mkdocs.yml").read_text(encoding="utf-8")
PAGES = sorted([*DOCS.rglob("*.md"), *TOP.glob("*.md")])


def test_every_page_has_a_place_in_the_navigation() -> None:
    named = set(re.findall(r"^ +- (?:[^:\n]+: )?([\w./-]+\.md)$", SETTINGS, re.M))
    there = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    there |= {
        path.relative_to(DOCS).with_suffix(".md").as_posix() for path in DOCS.rglob("*.ipynb")
    }
    assert named == there | {"index.md", "CONTRIBUTING.md", "CHANGELOG.md"}


def test_nothing_comes_from_outside() -> None:
    assert "font: false" in SETTINGS
    assert "https://" not in SETTINGS
    # A strict build fails where something that a page loads cannot become a file of the site.
    assert "- privacy" in SETTINGS
    assert "strict: true" in SETTINGS


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_link_to_a_file_leads_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.S)
    targets = re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", text)
    missing = [
        target
        for target in targets
        if not target.startswith(("http:", "https:", "mailto:"))
        and not (page.parent / target).exists()
    ]
    assert missing == []
