"""Names of docs/architecture.md and of its picture exist."""

import re
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import pytest

TOP = Path(__file__).resolve().parents[1]
TEXT = (TOP / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGES = ("pfwd_plugins", "pfwd_device", "inversion", "pfwd", "tui", "simulators")
NAMES = sorted(set(re.findall(rf"`((?:{'|'.join(PACKAGES)})\.[\w.]+)`", TEXT)))


def resolve(name: str) -> object:
    """Return the module, or the object in it."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            item: object = import_module(".".join(parts[:count]))
        except ModuleNotFoundError as err:
            if err.name is None or not name.startswith(err.name):
                raise
            continue
        for part in parts[count:]:
            item = getattr(item, part)
        return item
    raise AttributeError(name)


def test_the_document_names_functions() -> None:
    assert NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_name_of_the_document_exists(name: str) -> None:
    resolve(name)


@pytest.mark.parametrize(
    "name",
    ["pfwd_device.wire.no_such", "pfwd_device.no_such.binary"],
)
def test_a_name_that_does_not_exist_is_noticed(name: str) -> None:
    with pytest.raises(AttributeError):
        resolve(name)


def test_the_picture_has_names_of_the_document() -> None:
    root = ElementTree.parse(TOP / "docs" / "pictures" / "one-drop.svg").getroot()
    texts = {text.text or "" for text in root.iter("{http://www.w3.org/2000/svg}text")}
    named = {text for text in texts if re.fullmatch(r"[A-Z]\w+\.\w+|[a-z]+_[a-z_]+|[A-Z]\w+", text)}
    known = {
        part for name in NAMES for part in (name.rpartition(".")[2], ".".join(name.split(".")[-2:]))
    }
    assert named
    assert named <= known, named - known
