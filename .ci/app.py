"""Builds what laptops without Python or network need, and tries it: ``python3 dev.py app``.

    dist/pfwd      the program in one folder, Python and all packages in it (PyInstaller)
    dist/wheels    wheels of the program and of what it needs, for ``pip install --no-index``

Both are for the system and the processor that they are built on. On Linux they are tried where
neither a network nor this Python is in reach: in namespaces of their own, in which the folders of
Python are empty.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
DIST, WORK = TOP / "dist", TOP / "build" / "app"
PACKAGES = ("pfwd_plugins", "pfwd_device", "inversion", "pfwd", "tui", "simulators")
METADATA = ("pfwd", "numpy", "scipy", "h5py", "matplotlib", "textual")
"""Whose versions reports and --version name."""

LEFT_OUT = (
    *("tkinter", "pytest", "hypothesis", "IPython", "pandas", "pyarrow", "dask", "distributed"),
    *("pyogrio", "nbclient", "mypy", "ruff", "cryptography", "PyQt5", "PySide6", "python_calamine"),
    *("obspy", "nptdms", "xarray", "lxml", "chardet", "charset_normalizer", "yaml", "requests"),
)
"""Of the environment of the developers; the program does without them, or says what is missing."""

PATIENCE = 300.0
"""s; an old laptop's virus scanner looks at every file first."""


def call(*command: object, **more: object) -> None:
    """Run a command; the end of everything when it fails."""
    print("+", *command, flush=True)
    done = subprocess.call(list(map(str, command)), cwd=TOP, **more)  # type: ignore[call-overload]
    if done != 0:
        sys.exit(f"app: {command[0]} ended with {done}; what it says stands above")


def build_program() -> Path:
    """The folder of the program."""
    options: list[object] = ["--noconfirm", "--clean", "--onedir", "--console", "--name", "pfwd"]
    options += ["--distpath", DIST, "--workpath", WORK, "--specpath", WORK, "--log-level", "WARN"]
    for package in PACKAGES:
        options += ["--collect-submodules", package, "--collect-data", package]
    options += ["--collect-submodules", "textual", "--collect-data", "textual"]
    options += ["--collect-submodules", "skfem", "--collect-submodules", "serial"]
    for package in METADATA:
        options += ["--copy-metadata", package]
    for package in LEFT_OUT:
        options += ["--exclude-module", package]
    entry = TOP / ".ci" / "app_entry.py"
    call(sys.executable, "-m", "PyInstaller", *options, "--paths", TOP, entry)
    strip_symbols(DIST / "pfwd" / "_internal")
    return DIST / "pfwd"


def strip_symbols(folder: Path) -> None:
    """Remove the symbols of libraries on Linux: 50 MB, most of them in Python and Typst.

    Libraries of a package with a folder NAME.libs were changed after they were linked. Stripping
    can make them unreadable, so they remain.
    """
    strip = shutil.which("strip")
    if sys.platform != "linux" or strip is None:
        return
    libraries = [
        library
        for library in folder.rglob("*.so*")
        for package in [library.relative_to(folder).parts[0].removesuffix(".libs")]
        if not library.is_symlink() and not (folder / f"{package}.libs").exists()
    ]
    subprocess.run([strip, "--strip-unneeded", *libraries], check=True)


def build_wheels() -> Path:
    """The folder of the wheels."""
    folder = DIST / "wheels"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    python = (sys.executable, "-m")
    call(*python, "build", "--wheel", "--no-isolation", "--outdir", folder, TOP)
    (wheel,) = folder.glob("pfwd-*.whl")
    # Not "pip download": of some packages there are sources alone, and laptops have no compilers.
    pip = (*python, "pip", "wheel", "--quiet", "--disable-pip-version-check")
    call(*pip, "-c", "constraints.txt", "--wheel-dir", folder, wheel)
    return folder


def size_of(folder: Path) -> str:
    """In MB."""
    files = (file for file in folder.rglob("*") if file.is_file() and not file.is_symlink())
    return f"{sum(file.stat().st_size for file in files) / 1e6:.0f} MB"


def alone(hidden: Sequence[Path]) -> list[str] | None:
    """The beginning of a command that has no network and finds these folders empty; None: the
    system makes no such namespaces for this user."""
    unshare = shutil.which("unshare")
    if not sys.platform.startswith("linux") or unshare is None:
        return None
    steps = [f"mount -t tmpfs none '{folder}'" for folder in hidden if folder.is_dir()]
    # The command itself has no path to anything; what makes the namespace needs one.
    script = "; ".join(["kept=$PATH; PATH=/usr/sbin:/usr/bin:/sbin:/bin", *steps])
    command = [unshare, "-rmn", "/bin/sh", "-ec", script + '; PATH=$kept; exec "$@"', "-"]
    works = subprocess.run([*command, "/bin/true"], capture_output=True).returncode == 0
    return command if works else None


@contextmanager
def bare_folder() -> Iterator[tuple[Path, dict[str, str]]]:
    """A folder to work in and an environment without paths to any program."""
    with tempfile.TemporaryDirectory(prefix="pfwd-app-") as name:
        folder = Path(name)
        kept = {k: v for k, v in os.environ.items() if k in ("SYSTEMROOT", "TEMP", "TMP")}
        said = {"HOME": name, "PATH": str(folder / "nothing"), "TERM": "xterm-256color"}
        yield folder, {**kept, **said, "XDG_CACHE_HOME": name, "LC_ALL": "C.UTF-8"}


def try_commands(program: Sequence[object], *, with_screen: bool) -> None:
    """Demo, inversion, report and, on a pseudo-terminal, the screen, in an empty folder."""
    with bare_folder() as (folder, environment):
        survey = folder / "survey"
        for arguments in (
            ("--version",),
            ("demo", "--lines", "--drops", "3", "-o", survey),
            ("invert", survey, "--by", "point"),
            ("report", survey, "-o", folder / "report.pdf", "--jobs", "2"),
            ("export", survey, "--format", "xlsx", "-o", folder / "points.xlsx"),
            ("check", survey),
        ):
            begun = time.monotonic()
            done = subprocess.run(
                [*map(str, program), *map(str, arguments)],
                cwd=folder,
                env=environment,
                capture_output=True,
                text=True,
                timeout=PATIENCE,
            )
            if done.returncode != 0:
                sys.exit(f"app: pfwd {arguments[0]}: status {done.returncode}\n{done.stderr}")
            last = (done.stdout.strip().splitlines() or [""])[-1]
            took = time.monotonic() - begun
            print(f"  pfwd {arguments[0]}: {took:.1f} s; {last[:90]}", flush=True)
        if not (folder / "report.pdf").read_bytes().startswith(b"%PDF"):
            sys.exit("app: report.pdf is no PDF")
        if with_screen:
            try_screen(program, folder, environment)


def try_screen(program: Sequence[object], folder: Path, environment: dict[str, str]) -> None:
    """``pfwd live`` on a pseudo-terminal, with an instrument that the program simulates itself."""
    import pty
    import signal
    import threading

    # Both in one namespace: the second one would not see the port of the first.
    script = (
        '"$0" simulate --listen pty --drops 3 --json > url & '
        "while ! grep -q url url 2>/dev/null; do sleep 0.1; done; "
        'url=$(sed \'s/.*"url": *"\\([^"]*\\)".*/\\1/; q\' url); '
        'exec "$0" live "$url" -o live-survey'
    )
    *prefix, binary = map(str, program)
    keeper, terminal = pty.openpty()
    seen = bytearray()

    def read() -> None:
        while True:
            try:
                part = os.read(keeper, 65536)
            except OSError:
                return
            if not part:
                return
            seen.extend(part)

    command = [*prefix, "/bin/sh", "-c", script, binary]
    tools = {**environment, "PATH": "/bin:/usr/bin", "COLUMNS": "120", "LINES": "40"}
    with subprocess.Popen(
        command,
        cwd=folder,
        env=tools,
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
    ) as live:
        os.close(terminal)
        threading.Thread(target=read, daemon=True).start()
        end, drops = time.monotonic() + PATIENCE, list[Path]()
        while time.monotonic() < end and live.poll() is None:
            drops = list((folder / "live-survey").glob("drops/*.h5"))
            if drops and b"MPa" in seen:
                break
            time.sleep(0.2)
        os.killpg(live.pid, signal.SIGTERM)
        live.wait(60)
    if not drops or b"MPa" not in seen:
        tail = bytes(seen[-400:]).decode("utf-8", "replace")
        sys.exit(f"app: pfwd live recorded {len(drops)} drops; its screen ended with {tail!r}")
    print(f"  pfwd live: {len(drops)} drops recorded, {len(seen)} bytes of screen", flush=True)


def try_wheels(wheels: Path, beginning: Sequence[str]) -> None:
    """Install from the folder alone, then run what was installed."""
    with tempfile.TemporaryDirectory(prefix="pfwd-wheels-") as name:
        folder = Path(name) / "env"
        venv.create(folder, with_pip=True)
        scripts = folder / ("Scripts" if os.name == "nt" else "bin")
        python = scripts / ("python.exe" if os.name == "nt" else "python")
        pip = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        call(*beginning, *pip, "--no-index", "--find-links", wheels, "pfwd")
        print(f"  installed: {size_of(folder)}", flush=True)
        try_commands([*beginning, scripts / "pfwd"], with_screen=False)


def main() -> int:
    """Build and try both."""
    if "--try" in sys.argv[1:]:  # what was built before
        wheels, program = DIST / "wheels", DIST / "pfwd"
    else:
        wheels, program = build_wheels(), build_program()
    binary = program / ("pfwd.exe" if os.name == "nt" else "pfwd")
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    hidden = [Path(sys.prefix), Path(sys.base_prefix) / "lib" / version]
    beginning = alone(hidden)
    if beginning is None:
        print("app: tried without closing off Python and network: the system does not allow it")
    print(f"the program in {program}, {size_of(program)}:", flush=True)
    try_commands([*(beginning or []), binary], with_screen=os.name == "posix")
    print(f"the wheels in {wheels}, {size_of(wheels)}:", flush=True)
    try_wheels(wheels, alone([]) or [])
    print("PASSED", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
