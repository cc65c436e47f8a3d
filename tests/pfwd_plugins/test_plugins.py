"""Extensions of other packages, and remarks on those that cannot be used."""

import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

import pfwd_plugins
from tests.installed_package import install

GROUP = "pfwd.effects"
pytestmark = pytest.mark.filterwarnings("ignore::pfwd_plugins.PluginWarning")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with installed packages, before all others on the path."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    pfwd_plugins.forget()
    yield folder
    pfwd_plugins.forget()
    for name in [name for name in sys.modules if name.startswith("some_")]:
        del sys.modules[name]


def test_an_entry_point_is_listed_and_loaded_on_request(site: Path) -> None:
    install(site, {"some_good.py": "VALUE = 7.5\n"}, f"[{GROUP}]\nseven = some_good:VALUE\n")
    assert pfwd_plugins.names(GROUP) == ("seven",)
    assert pfwd_plugins.package_of(GROUP, "seven") == "toy 0.1"
    assert "some_good" not in sys.modules
    assert pfwd_plugins.load(GROUP, "seven", float) == 7.5
    assert list(pfwd_plugins.load_all(GROUP, float)) == [("seven", 7.5)]
    assert pfwd_plugins.load(GROUP, "eight", float) is None
    assert pfwd_plugins.names("pfwd.dialects") == ()
    assert pfwd_plugins.remarks() == ()


@pytest.mark.parametrize(
    ("source", "value", "expected"),
    [
        ("import no_such_module\n", "some_bad:X", "ModuleNotFoundError: No module named"),
        ("raise ValueError('first\\nsecond')\n", "some_bad:X", "got ValueError: first second;"),
        ("import sys\nsys.exit(3)\n", "some_bad:X", "got SystemExit: 3"),
        ("X = (\n", "some_bad:X", "got SyntaxError"),
        ("Y = 1.0\n", "some_bad:X", "got AttributeError"),
        ("X = 'text'\n", "some_bad:X", "expected a float at some_bad:X, got a str;"),
        ("X = None\n", "some_bad:X", "expected a float at some_bad:X, got a NoneType;"),
        ("X = 1.0\n", "some bad", "is left out: expected an object that can be imported"),
    ],
)
def test_a_broken_plugin_is_a_remark_and_the_rest_is_loaded(
    site: Path, source: str, value: str, expected: str
) -> None:
    install(site, {"some_bad.py": source}, f"[{GROUP}]\nbad = {value}\n", "broken-toy")
    install(site, {"some_good.py": "X = 2.0\n"}, f"[{GROUP}]\ngood = some_good:X\n")
    for _ in range(2):  # and one remark, however often it is loaded
        assert list(pfwd_plugins.load_all(GROUP, float)) == [("good", 2.0)]
    (remark,) = pfwd_plugins.remarks()
    assert remark.startswith(f"plug-in bad of broken-toy 0.1 ({GROUP}) is left out: expected ")
    assert expected in remark
    assert remark.endswith("; update or uninstall the package")
    assert "\n" not in remark


def test_a_script_is_warned_once(site: Path) -> None:
    install(site, {"some_bad.py": "import no_such_module\n"}, f"[{GROUP}]\nbad = some_bad:X\n")
    with pytest.warns(pfwd_plugins.PluginWarning, match="plug-in bad of toy"):
        pfwd_plugins.load(GROUP, "bad", float)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pfwd_plugins.load(GROUP, "bad", float)


def test_a_plugin_does_not_replace_a_built_in_name(site: Path) -> None:
    install(site, {"some_good.py": "X = 2.0\n"}, f"[{GROUP}]\nown = some_good:X\n")
    assert list(pfwd_plugins.load_all(GROUP, float, {"own"})) == []
    (remark,) = pfwd_plugins.remarks()
    assert "expected a name of its own, got one that this program has" in remark
    assert "some_good" not in sys.modules


@pytest.mark.parametrize("entry", ["", ".", "absolute"])
def test_packages_in_the_current_folder_are_ignored(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str
) -> None:
    received = tmp_path / "received"
    received.mkdir()
    install(received, {"some_mark.py": "X = 1.0\n"}, f"[{GROUP}]\nmark = some_mark:X\n", "mark")
    monkeypatch.chdir(received)
    monkeypatch.setattr(sys, "path", [str(received) if entry == "absolute" else entry, *sys.path])
    pfwd_plugins.forget()
    assert "mark" not in pfwd_plugins.names(GROUP)
    assert pfwd_plugins.load(GROUP, "mark", float) is None
    assert "some_mark" not in sys.modules


def test_the_same_package_twice_on_the_path_counts_once(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    second = tmp_path / "second"
    for folder, value in ((site, 1.0), (second, 2.0)):
        install(folder, {"some_good.py": f"X = {value}\n"}, f"[{GROUP}]\nx = some_good:X\n")
    monkeypatch.setattr(sys, "path", [str(site), str(second), *sys.path[1:]])
    pfwd_plugins.forget()
    assert list(pfwd_plugins.load_all(GROUP, float)) == [("x", 1.0)]
    assert pfwd_plugins.remarks() == ()


def test_the_current_folder_is_excluded_in_any_spelling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file systems of macOS and Windows do not distinguish upper and lower case."""
    trusted = tmp_path / "trusted"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", str(tmp_path), str(tmp_path).upper(), str(trusted)])
    assert pfwd_plugins._trusted_path() == [str(trusted)]
