"""Sources of the site: every page is in the navigation, every link leads to a file.

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
    present = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    present |= {
        path.relative_to(DOCS).with_suffix(".md").as_posix() for path in DOCS.rglob("*.ipynb")
    }
    assert named == present | {"index.md", "CONTRIBUTING.md", "CHANGELOG.md"}


def test_the_site_loads_no_external_files() -> None:
    assert "font: false" in SETTINGS
    assert "https://" not in SETTINGS
    # A strict build fails if a file that a page loads cannot be stored in the site.
    assert "- privacy" in SETTINGS
    assert "strict: true" in SETTINGS


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_link_to_a_file_is_valid(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.S)
    targets = re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", text)
    missing = [
        target
        for target in targets
        if not target.startswith(("http:", "https:", "mailto:"))
        and not (page.parent / target).exists()
    ]
    assert missing == []


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda path: path.name)
def test_files_that_a_page_names_exist(page: Path) -> None:
    pattern = r"`((?:tests|pfwd\w*|inversion|simulators|tui)/[\w/]+(?:\.py)?)`"
    names = re.findall(pattern, page.read_text(encoding="utf-8"))
    in_the_wheel = "simulators/firmware_sources"
    assert [name for name in names if name != in_the_wheel and not (TOP / name).exists()] == []
