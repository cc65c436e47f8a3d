"""What docs/architecture.md names is there: a renamed function turns this red."""

import re
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import pytest

TOP = Path(__file__).resolve().parents[1]
TEXT = (TOP / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGES = ("pfwd_plugins", "pfwd_device", "inversion", "pfwd_survey", "tui", "simulators")
NAMES = sorted(set(re.findall(rf"`((?:{'|'.join(PACKAGES)})\.[\w.]+)`", TEXT)))


def look_up(name: str) -> object:
    """The module, or what it holds."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = import_module(".".join(parts[:count]))
        except ModuleNotFoundError as err:
            if err.name is None or not name.startswith(err.name):
                raise
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise AttributeError(name)


def test_there_is_much_to_look_up() -> None:
    assert len(NAMES) > 80


@pytest.mark.parametrize("name", NAMES)
def test_what_the_document_names_exists(name: str) -> None:
    look_up(name)


@pytest.mark.parametrize(
    "name",
    [
        "pfwd_device.wire.no_such",
        "pfwd_device.no_such.binary",
        "inversion.result.no_such",
    ],
)
def test_what_is_not_there_is_noticed(name: str) -> None:
    with pytest.raises(AttributeError):
        look_up(name)


def test_every_station_names_something() -> None:
    stations = [line for line in TEXT.splitlines() if re.match(r"\| \d+[ab]? \|", line)]
    assert len(stations) == 20 + 9 + 6
    for line in stations:
        assert "`" in line or line.split("|")[2].strip() == "the listener of the session", line


def test_the_picture_names_stations_of_the_document() -> None:
    root = ElementTree.parse(TOP / "docs" / "pictures" / "one-drop.svg").getroot()
    texts = {text.text or "" for text in root.iter("{http://www.w3.org/2000/svg}text")}
    named = {text for text in texts if re.fullmatch(r"[A-Z]\w+\.\w+|[a-z]+_[a-z_]+|[A-Z]\w+", text)}
    known = {
        part for name in NAMES for part in (name.rpartition(".")[2], ".".join(name.split(".")[-2:]))
    }
    assert len(named) > 12
    assert named <= known, named - known


def test_nothing_is_named_with_a_path_that_is_gone() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (TOP / "docs" / link).exists(), link
