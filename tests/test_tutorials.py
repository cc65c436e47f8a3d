"""The tutorials run with the stored results.

After an intended change run the tests with ``PFWD_NEW_TUTORIALS=1``, which stores the results.
Read the difference in git.
"""

import os
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

from tests.documented import check_text

TOP = Path(__file__).resolve().parents[1]
TUTORIALS = sorted((TOP / "docs" / "tutorials").glob("*.ipynb"))
MAX_BYTES = 200_000
"""Size of a tutorial with its pictures."""
# Small pictures, without the settings of the user.
ENVIRONMENT = {
    "PYTHONPATH": str(TOP),
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "PYDEVD_DISABLE_FILE_VALIDATION": "1",
}


def test_all_tutorials_are_run() -> None:
    assert [path.stem for path in TUTORIALS] == [
        "a-survey-as-tables-and-plots",
        "arrays-to-a-modulus",
        "from-a-residual-to-its-effect",
    ]


# On Windows the client of the kernel warns that it reads its sockets in a separate thread.
@pytest.mark.filterwarnings("ignore:Proactor event loop:RuntimeWarning")
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_has_the_stored_results(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    stored = nbformat.read(path, as_version=4)
    run = nbformat.read(path, as_version=4)
    for cell in run.cells:
        cell.metadata = {}
    client = NotebookClient(
        run,
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
        record_timing=False,
        coalesce_streams=True,  # a busy machine sends a text in parts
    )
    client.execute()
    assert list(tmp_path.iterdir()) == []
    if os.environ.get("PFWD_NEW_TUTORIALS"):
        run.metadata = stored.metadata
        nbformat.write(run, path)
        return
    assert path.stat().st_size < MAX_BYTES
    for before, now in zip(stored.cells, run.cells, strict=True):
        if before.cell_type == "code":
            assert [kind(output) for output in now.outputs] == [kind(o) for o in before.outputs]
            for output, expected in zip(now.outputs, before.outputs, strict=True):
                check_text(text_of(output), text_of(expected))


def kind(output: Any) -> tuple[str, ...]:
    """Return the type of an output and of its data."""
    return (output.output_type, *sorted(output.get("data", {})))


def text_of(output: Any) -> str:
    """Return the visible text of an output; pictures are not compared."""
    data = output.get("data", {})
    if "image/png" in data:
        return ""
    return str(output.get("text") or data.get("text/html") or data.get("text/plain") or "")
