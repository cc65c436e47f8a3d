"""Layout of a PDF by a template of the user, in a process with limits.

A template is a program: it may read files, import packages and compute without end, and it may come
from a stranger. Therefore it runs in a process of its own, which reads only a copy of the
template's folder, has no packages from the network, and is ended after a time. Its memory is
limited on Linux alone: other systems do not enforce such a limit.
"""

import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pfwd.errors import OptionError, refusal
from pfwd.jobs import Jobs, WorkerDied

STANDARDS: tuple[Literal["a-2a"], Literal["ua-1"]] = ("a-2a", "ua-1")
"""Archiving with tags, and accessibility. Typst refuses to write a file that breaks their rules."""

MAX_RENDER_S = 600.0
"""Longest time of a layout."""

MAX_RENDER_BYTES = 4_000_000_000
"""Largest address space of the process."""

MAX_TEMPLATE_FILES, MAX_TEMPLATE_BYTES = 1000, 100_000_000
"""Limits for the folder of a template with its folders."""

_DATA, _PDF, _COPY = "data.json", "report.pdf", "template"


def render_apart(template: Path, data: str, fonts: Sequence[str]) -> bytes:
    """Return the PDF that a template makes of the data.

    Parameters
    ----------
    template : Path
    data : str
        Content of the report as JSON, described in docs/reports.md.
    fonts : sequence of str
        Folders with fonts.

    Raises
    ------
    OptionError
        If the template or its folder is refused, or the layout exceeds a limit.
    """
    where, template = f"--template {template}", template.resolve()
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            _copy_folder(template.parent, folder / _COPY, where)
            (folder / _DATA).write_text(data, encoding="utf-8")
            reason = _run(folder, template.name, fonts)
            if reason is None:
                return (folder / _PDF).read_bytes()
    except OSError as err:
        raise OptionError(refusal(where, "a folder that can be copied", str(err))) from err
    limits = f"{MAX_RENDER_S / 60:.3g} minutes and {MAX_RENDER_BYTES / 1e9:.3g} GB"
    expected = f"a template that Typst can render from its folder alone, in at most {limits}"
    raise OptionError(refusal(where, expected, reason))


def _copy_folder(source: Path, target: Path, where: str) -> None:
    """Copy a folder without links, devices and hidden folders."""
    sizes: list[int] = []

    def ignored(folder: str, names: list[str]) -> set[str]:
        files = [Path(folder, name) for name in names]
        taken = [f for f in files if f.is_file() or (f.is_dir() and f.name[0] != ".")]
        taken = [file for file in taken if not file.is_symlink()]
        sizes.extend(file.stat().st_size for file in taken)
        if len(sizes) > MAX_TEMPLATE_FILES or sum(sizes) > MAX_TEMPLATE_BYTES:
            limits = f"{MAX_TEMPLATE_FILES} files and {MAX_TEMPLATE_BYTES / 1e6:.0f} MB"
            hint = "move the template into a folder of its own"
            raise OptionError(refusal(where, f"a folder of at most {limits}", "more", hint))
        return set(names).difference(file.name for file in taken)

    shutil.copytree(source, target, symlinks=True, ignore=ignored)


def _run(folder: Path, name: str, fonts: Sequence[str]) -> str | None:
    """Lay out in a process of its own; return None, or why there is no PDF."""
    with Jobs(attempts=1) as jobs:
        try:
            return jobs.submit(_lay_out, folder, name, fonts).result(MAX_RENDER_S)
        except TimeoutError:
            return "a longer time"
        except (WorkerDied, MemoryError):
            return "an end of Typst without result, as for lack of memory"


def _lay_out(folder: Path, name: str, fonts: Sequence[str]) -> str | None:
    """Write the PDF of a folder; return None, or why Typst refuses the template."""
    if sys.platform == "linux":
        import resource

        for kind, limit in ((resource.RLIMIT_AS, MAX_RENDER_BYTES), (resource.RLIMIT_CORE, 0)):
            hard = resource.getrlimit(kind)[1]
            resource.setrlimit(kind, (limit if hard < 0 else min(limit, hard), hard))
    # Typst has no option against downloads, but takes the proxy from these variables. There is none
    # at port 0, of any computer.
    proxy = "http://127.0.0.1:0"
    os.environ.update(https_proxy=proxy, HTTPS_PROXY=proxy, no_proxy="", NO_PROXY="")
    import typst

    root = str(folder / _COPY)
    try:
        compiler = typst.Compiler(
            Path(root, name).read_bytes(),
            root=root,
            font_paths=typst.Fonts(font_paths=[*fonts]),
            sys_inputs={"data": (folder / _DATA).read_text(encoding="utf-8")},
            package_path=root,
            package_cache_path=root,
        )
        pdf = compiler.compile(format="pdf", pdf_standards=[*STANDARDS])
    except typst.TypstError as err:
        return " ".join([err.message, *err.hints]).strip()[:2000]
    assert isinstance(pdf, bytes)
    (folder / _PDF).write_bytes(pdf)
    return None
