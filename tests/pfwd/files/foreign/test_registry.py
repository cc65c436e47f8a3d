"""The reader of a file, with readers of other packages."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import pfwd_plugins
from pfwd.archive.run import find_sources
from pfwd.errors import TraceError
from pfwd.files.foreign import registry
from pfwd.files.reading import read_points
from tests.installed_package import install
from tests.pfwd.files.foreign.builders import pulse, thy
from tests.pfwd.files.foreign.peaks_builders import places, sweco

pytestmark = pytest.mark.filterwarnings("ignore::pfwd_plugins.PluginWarning")

SOURCE = """
from pfwd.files.foreign.registry import Format

def recognises(head):
    {recognises}

def read(file, request):
    {read}

FORMAT = Format("toys", (".thy", ".toy", ".csv"), read, recognises)
"""

SWECO = sweco(places()).encode()

Offer = Callable[..., None]


@pytest.fixture
def offer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Offer]:
    """Installs a package with a reader."""
    number = iter(range(100))

    def put(recognises: str = "return False", read: str = "return []") -> None:
        module = f"reader_{tmp_path.name.replace('-', '_')}_{next(number)}"
        source = SOURCE.format(recognises=recognises, read=read)
        folder = tmp_path / module
        points = f"[pfwd.import_formats]\ntoys = {module}:FORMAT\n"
        install(folder, {f"{module}.py": source}, points)
        monkeypatch.syspath_prepend(folder)
        pfwd_plugins.forget()
        registry._plugin_formats.cache_clear()

    yield put
    pfwd_plugins.forget()
    registry._plugin_formats.cache_clear()


def test_every_reader_can_be_imported() -> None:
    for form in (*registry.FOREIGN_FORMATS, registry.DELIMITED_TEXT):
        assert callable(form.reader())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\0" * 5000 + SWECO, r"begins with R80 \(Dynatest\) or has the line ROAD SYSTEM \(Sweco"),
        (b"PK\5\6" + bytes(18), "expected database.json or database.xml in the archive"),
        (b"XX\3\4" + bytes(range(256)), "save a table as CSV in UTF-8, copy a damaged file again"),
    ],
)
def test_a_damaged_file_is_not_refused_by_the_reader_of_another_format(
    tmp_path: Path, content: bytes, message: str
) -> None:
    file = tmp_path / "a.fwd"
    if content.startswith((b"PK", b"XX")):
        file = tmp_path / "a.zip"
    file.write_bytes(content)
    with pytest.raises(TraceError, match=message):
        read_points(file)


def test_a_sweco_file_without_its_first_lines_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.fwd").write_bytes(SWECO.replace(b"ROAD SYSTEM", b"XXXX"))
    assert len(read_points(tmp_path / "a.fwd")) == len(places())


def test_a_file_of_ours_is_never_read_by_another_package(offer: Offer, tmp_path: Path) -> None:
    offer("return True", "raise AssertionError")
    traces = tmp_path / "traces.csv"
    traces.write_text("# pfwd-traces = 1\n")
    assert registry.find_format(str(traces)) is None
    jils = tmp_path / "a.thy"
    jils.write_bytes(thy([(1, 1, pulse())]))
    assert registry.find_format(str(jils)) is registry.FOREIGN_FORMATS[1]


@pytest.mark.parametrize("name", ["a.toy", "b.TOY"])
def test_another_package_reads_by_the_end_of_the_name(
    offer: Offer, tmp_path: Path, name: str
) -> None:
    offer()
    (tmp_path / name).write_text("what only it knows")
    assert read_points(tmp_path / name) == []
    assert tmp_path / name in [Path(source.path) for source in find_sources([str(tmp_path)])]


def test_an_error_of_a_plugin_names_its_package(offer: Offer, tmp_path: Path) -> None:
    offer(read="return 1 / 0")
    (tmp_path / "a.toy").write_text("x")
    with pytest.raises(TraceError, match=r"a\.toy: expected a file that toy 0\.1 reads, got Zero"):
        read_points(tmp_path / "a.toy")


def test_a_broken_plugin_is_a_remark(offer: Offer, tmp_path: Path) -> None:
    offer("return head.no_such_thing")
    (tmp_path / "a.other").write_text("x")
    assert registry.find_format(str(tmp_path / "a.other")) is None
    (remark,) = pfwd_plugins.remarks()
    assert "expected True or False from recognises(), got AttributeError" in remark
