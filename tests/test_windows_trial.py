"""The list of tests that a Windows under wine skips, and the table of results of `.ci/windows`."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

TOP = Path(__file__).resolve().parents[1]

RESULTS = """<testsuites><testsuite name="pytest">
<testcase classname="tests.test_a" name="test_1"/>
<testcase classname="tests.test_a" name="test_2">
<failure message="assert 1 == 2&#10;more"/></testcase>
<testcase classname="tests.test_a" name="test_3"><error message="no fixture"/></testcase>
<testcase classname="tests.test_a" name="test_4"><skipped message="no pty"/></testcase>
</testsuite></testsuites>"""


@pytest.fixture
def windows_tests() -> ModuleType:
    path = TOP / ".ci" / "windows_tests.py"
    spec = importlib.util.spec_from_file_location("windows_tests", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_skipped_test_exists_and_has_a_reason(windows_tests: ModuleType) -> None:
    for name, reason in windows_tests.reasons_by_test().items():
        file, _, test = name.partition("::")
        source = (TOP / file).read_text(encoding="utf-8")
        assert re.search(rf"def {re.escape(test.partition('[')[0].split('::')[-1])}\b", source), (
            name
        )
        assert len(reason.split()) > 3, name


def test_a_failed_test_fails_the_trial_and_is_named(
    windows_tests: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "tests-wire.xml").write_text(RESULTS, encoding="utf-8")
    assert windows_tests.main(tmp_path) == 1
    shown = capsys.readouterr().out
    assert "failed: tests.test_a::test_2: assert 1 == 2\n" in shown
    assert "skipped 1: no pty\n" in shown
    assert re.search(r"^all +1 +2 +1$", shown, re.MULTILINE)


def test_no_result_is_no_success(windows_tests: ModuleType, tmp_path: Path) -> None:
    assert windows_tests.main(tmp_path) == 1
