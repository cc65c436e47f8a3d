"""Layout of a PDF by a template of the user, in a process with limits.

A template is a program: it may read files, import packages and compute without end, and it may come
from a stranger. Therefore it runs in a process of its own, which reads only a copy of the
template's folder, has no packages from the network, and is ended after a time. Its memory is
limited on Linux alone: other systems do not enforce such a limit.
"""

import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pfwd.errors import OptionError, refusal
from pfwd_device.child_python import start_child

MAX_RENDER_S = 600.0
"""Longest time of a layout."""

MAX_RENDER_BYTES = 4_000_000_000
"""Largest address space of the process."""

MAX_TEMPLATE_FILES, MAX_TEMPLATE_BYTES = 1000, 100_000_000
"""Limits for the folder of a template with its folders."""

_TASK, _PDF, _COPY = "task.json", "report.pdf", "template"
_REFUSED = 3
"""Exit status of the process when Typst refuses the template."""


def render_apart(
    template: Path, data: dict[str, Any], fonts: Sequence[str], standards: Sequence[str]
) -> bytes:
    """Return the PDF that a template makes of the data.

    Parameters
    ----------
    template : Path
    data : dict
        Content of the report, described in docs/reports.md.
    fonts : sequence of str
        Folders with fonts.
    standards : sequence of str
        Standards of the PDF.

    Raises
    ------
    OptionError
        If the template or its folder is refused, or the layout exceeds a limit.
    """
    where = f"--template {template}"
    template = template.resolve()
    task = {"template": template.name, "fonts": fonts, "standards": standards, "data": data}
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            _copy_folder(template.parent, folder / _COPY, where)
            (folder / _TASK).write_text(json.dumps(task, ensure_ascii=False), encoding="utf-8")
            reason = _run(folder)
            if reason is None:
                return (folder / _PDF).read_bytes()
    except OSError as err:
        raise OptionError(refusal(where, "a folder that can be copied", str(err))) from err
    limits = f"{MAX_RENDER_S / 60:.3g} minutes and {MAX_RENDER_BYTES / 1e9:.3g} GB"
    expected = f"a template that Typst can render from its folder alone, in at most {limits}"
    raise OptionError(refusal(where, expected, reason))


def _copy_folder(source: Path, target: Path, where: str) -> None:
    """Copy a folder without links, devices and hidden folders."""
    count = size = 0
    for folder, folders, names in os.walk(source):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for file in (Path(folder, name) for name in names):
            status = file.lstat()
            if not stat.S_ISREG(status.st_mode):
                continue
            count, size = count + 1, size + status.st_size
            if count > MAX_TEMPLATE_FILES or size > MAX_TEMPLATE_BYTES:
                limits = f"{MAX_TEMPLATE_FILES} files and {MAX_TEMPLATE_BYTES / 1e6:.0f} MB"
                hint = "move the template into a folder of its own"
                raise OptionError(refusal(where, f"a folder of at most {limits}", "more", hint))
            place = target / file.relative_to(source)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, place, follow_symlinks=False)


def _run(folder: Path) -> str | None:
    """Run the process on a folder; return None, or why there is no PDF."""
    with start_child("-m", __name__, str(folder)) as process:
        try:
            status = process.wait(MAX_RENDER_S)
        except subprocess.TimeoutExpired:
            return "a longer time"
        finally:
            process.kill()
        assert process.stdout is not None
        if status == _REFUSED:
            return process.stdout.read().decode("utf-8", "replace")
        return None if status == 0 else "an end of Typst without result, as for lack of memory"


def main(folder: Path) -> int:
    """Lay out the PDF of a task in its folder and return the exit status of the process."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if sys.platform == "linux":
        import resource

        for kind, limit in ((resource.RLIMIT_AS, MAX_RENDER_BYTES), (resource.RLIMIT_CORE, 0)):
            hard = resource.getrlimit(kind)[1]
            resource.setrlimit(kind, (limit if hard < 0 else min(limit, hard), hard))
    # Typst has no option against downloads, but takes the proxy from these variables. There is none
    # at port 0, of any computer.
    for name in ("https_proxy", "HTTPS_PROXY"):
        os.environ[name] = "http://127.0.0.1:0"
    for name in ("no_proxy", "NO_PROXY"):
        os.environ.pop(name, None)
    import typst

    task = json.loads((folder / _TASK).read_text(encoding="utf-8"))
    root = str(folder / _COPY)
    try:
        compiler = typst.Compiler(
            Path(root, task["template"]).read_bytes(),
            root=root,
            font_paths=typst.Fonts(font_paths=task["fonts"]),
            sys_inputs={"data": json.dumps(task["data"], ensure_ascii=False)},
            package_path=root,
            package_cache_path=root,
        )
        pdf = compiler.compile(format="pdf", pdf_standards=task["standards"])
    except typst.TypstError as err:
        sys.stdout.buffer.write(" ".join([err.message, *err.hints]).strip().encode()[:2000])
        return _REFUSED
    assert isinstance(pdf, bytes)
    (folder / _PDF).write_bytes(pdf)
    return 0


def _end_with_parent() -> None:
    sys.stdin.buffer.read()  # ends when the parent does
    os._exit(1)


if __name__ == "__main__":
    status = main(Path(sys.argv[1]))
    sys.stdout.flush()
    os._exit(status)  # the thread still waits for the parent
