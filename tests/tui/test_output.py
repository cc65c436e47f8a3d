"""Lines for machines and text from elsewhere."""

import io
import json
import os
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest

from pfwd.export.json_text import json_text
from tests.tui.console import PFWD, TOP
from tui.output import clean, next_commands, spell_signs, spelled


def test_the_next_commands_can_be_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    assert next_commands("s1") == ("pfwd open s1", "pfwd report s1 -o report.html")
    opening = {}
    for name in ("posix", "nt"):
        with monkeypatch.context() as patched:
            patched.setattr("tui.output.os.name", name)
            opening[name] = next_commands(r"C:\T\Ring road")[0]
    assert opening["posix"] == r"pfwd open 'C:\T\Ring road'"
    assert opening["nt"] == r'pfwd open "C:\T\Ring road"'


def test_json_has_values_of_numpy_and_no_infinity() -> None:
    line = json_text(
        {
            "array": np.array([1.5, np.nan]),
            "scalars": [np.float64(2.5), np.int64(3), np.bool_(True), None],
            "nested": {"pair": (1, float("-inf"))},
            "text": "km 12\n\x1b",
        }
    )
    assert "\n" not in line
    assert line.isascii()
    assert json.loads(line) == {
        "array": [1.5, None],
        "scalars": [2.5, 3, True, None],
        "nested": {"pair": [1, None]},
        "text": "km 12\n\x1b",
    }


@pytest.mark.parametrize(
    "hostile", ["\x1b]0;owned\x07", "\x9b31m", "a\0b", "a\r\nb", "\u202eabc", "\ud800", "\x7f"]
)
def test_characters_that_steer_a_terminal_are_replaced(hostile: str) -> None:
    text = clean(hostile)
    assert text.isprintable()
    assert len(text) == len(hostile)
    harmless = "Ring road km 12 · [red]x[/blue], 50 µm ± 2 %"
    assert clean(harmless) == harmless


@pytest.mark.parametrize("text", ["η 5 ± 1 kPa s", "ρ kg/m³, 5–7 µm ≥ 3 °C …", "km 12 中"])
def test_a_console_without_the_letters_gets_words_and_no_question_marks(text: str) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    words = spelled(text, stream)
    assert words.isascii()
    assert "?" not in words
    assert spelled("η ρ ± µm ²", stream) == "eta rho +- um 2"
    assert spelled(text, io.TextIOWrapper(io.BytesIO(), encoding="utf-8")) == text


@pytest.mark.parametrize("page", ["cp850", "cp1252"])
@pytest.mark.parametrize(("name", "is_terminal"), [("nt", False), ("nt", True), ("posix", False)])
def test_a_pipe_of_windows_gets_no_sign_that_code_pages_encode_differently(
    page: str, name: str, is_terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PowerShell reads a pipe in the code page of the console, which is another one."""
    buffer = io.BytesIO()
    stream = io.TextIOWrapper(buffer, encoding=page, newline="\n", write_through=True)
    monkeypatch.setattr(stream, "isatty", lambda: is_terminal, raising=False)
    monkeypatch.setattr("tui.output.os", SimpleNamespace(name=name))
    spell_signs(stream)
    print("50 µm ± 2 °C, kg/m³, ν 0.35, Süd 中", file=stream)
    text = buffer.getvalue().decode(page)
    if (name, is_terminal) == ("nt", False):
        assert text == "50 um +- 2 degC, kg/m3, nu 0.35, Süd \\u4e2d\n"
        assert spelled("± ν Süd", stream) == "+- nu Süd"
    else:
        assert text == "50 µm ± 2 °C, kg/m³, nu 0.35, Süd \\u4e2d\n"


@pytest.mark.posix  # Windows does not ask the environment for its code page
def test_the_command_spells_where_the_locale_is_plain() -> None:
    completed = subprocess.run(
        [*PFWD, "procedures", "tp-bf-stb-b8.3"],
        cwd=TOP,
        capture_output=True,
        env={**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    assert completed.stdout.isascii()
    assert b"?" not in completed.stdout
