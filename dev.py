"""Sets up the environment and runs the program or its checks; needs nothing but Python 3.11.

    python3 dev.py demo [ARGS]   set up what the program needs, then `pfwd demo ARGS`
    python3 dev.py test [ARGS]   add the tools, then run every check and the everyday tests; ARGS
                                 go to pytest (-m "" for the slow tests as well)
    python3 dev.py check         add the tools, then run the static checks alone
    python3 dev.py docs          add the tools, then build the site, strictly, into the folder site
    python3 dev.py app           add the tools, then build the program in one folder and a folder
                                 of wheels, for computers without Python or network; try both
    python3 dev.py release [--check]  add the tools, then build what a release consists of and try
                                 it; --check lists what is missing for a release
    python3 dev.py mutate MODULE [ARGS]  add the tools, then change MODULE and see whether its
                                 tests notice; ARGS as in .ci/mutate.py

What is there is not installed again, until pyproject.toml or constraints.txt changes.

The environment is the folder .venv beside this file, or the one that PFWD_VENV names. With
--python VERSION anywhere behind the task, as in `test --python 3.13`, another Python of this
computer does it, in an environment of its own (.venv-3.13).
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
import venv
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

if sys.version_info < (3, 11):
    sys.exit("dev.py: expected Python 3.11 or later, got " + sys.version.split()[0])

TOP = Path(__file__).resolve().parent
VENV = Path(os.environ.get("PFWD_VENV") or TOP / ".venv").resolve()
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
STEPS = {
    "": "what the program needs (120 MB to download, 400 MB on the disk, about half a minute)",
    "dev": "program and tools of the tests (up to 240 MB to download, 1 GB on the disk, 2 minutes)",
    "docs": "the tools of the site (the first time 25 MB to download, half a minute)",
    "app": "the tools of the one-folder program (the first time 2 MB to download, half a minute)",
    "release": "the tools of a release (the first time 35 MB to download, a minute)",
    "mutate": "the tools that change the code (the first time 8 MB to download, a minute)",
}
"""Extra of pyproject.toml ("": none), and what its installation takes on a line of 50 Mbit/s."""

STATIC_CHECKS = {
    "ruff": ["ruff", "check", "."],
    "format": ["ruff", "format", "--check", "."],
    # A system that is not this one cannot be run, but what does not exist there can be found.
    "mypy for Linux": ["mypy", "--platform", "linux"],
    "mypy for Windows": ["mypy", "--platform", "win32", "--cache-dir", ".mypy_cache/win32"],
    "mypy for macOS": ["mypy", "--platform", "darwin", "--cache-dir", ".mypy_cache/darwin"],
    "imports": ["lint-imports"],
    "workflows": [
        *("check-jsonschema", "--builtin-schema", "vendor.github-workflows"),
        *map(str, sorted((TOP / ".github" / "workflows").glob("*.yml"))),
    ],
}


def find_python(version: str) -> str:
    """The interpreter of a version: on the path, known to Windows' launcher, or kept by pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    kept = [pyenv / version, *pyenv.glob(f"{version}.*")]
    tried = [[f"python{version}"], *([["py", f"-{version}"]] if os.name == "nt" else [])]
    tried += [[str(folder / "bin" / "python")] for folder in sorted(kept, reverse=True)]
    question = "import sys; print(sys.executable); print(sys.version.split()[0])"
    for command in tried:
        if shutil.which(command[0]):
            # A name on the path may stand for a version that is not chosen: then it fails.
            done = subprocess.run([*command, "-c", question], capture_output=True, text=True)
            found = done.stdout.splitlines()
            if done.returncode == 0 and f"{found[1]}.".startswith(f"{version}."):
                return found[0]
    sys.exit(f"dev.py: --python: expected a Python {version} on this computer, got none")


def with_python(version: str, arguments: list[str]) -> int:
    """Let another Python do it, in an environment of its own."""
    environment = {"PFWD_VENV": str(TOP / f".venv-{version}"), **os.environ}
    return subprocess.call([find_python(version), __file__, *arguments], env=environment)


def run(command: list[str]) -> int:
    print("+", *command, flush=True)
    return subprocess.call([str(BIN / command[0]), *command[1:]], cwd=TOP)


def passes(command: list[str]) -> bool:
    """Run a check beside another, and show what it says when it ends."""
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run([str(BIN / command[0]), *command[1:]], cwd=TOP, **pipe)
    print("+", *command, f"\n{done.stdout.decode(errors='replace')}", end="", flush=True)
    return done.returncode == 0


def install(extra: str) -> None:
    """Install the checkout with an extra of pyproject.toml into the environment."""
    print(f"dev.py: installing {STEPS[extra]}", flush=True)
    pip = ["python", "-m", "pip", "install", "--disable-pip-version-check"]
    if not sys.stdout.isatty():
        pip.append("--quiet")  # pip's progress is for a terminal; in a log it is a hundred lines
    if not extra:
        pip.append("--no-compile")  # Python does it for what the demo imports, a third of it all
    if run([*pip, "-c", "constraints.txt", "-e", f".[{extra}]" if extra else "."]) != 0:
        sys.exit(
            "dev.py: packages not installed: the reason is above. Check the network, then start "
            "the same command again"
        )


def has_pip() -> bool:
    """Whether the environment is complete; it is not where its creation was interrupted."""
    command = [str(PYTHON), "-m", "pip", "--version"]
    return PYTHON.exists() and subprocess.run(command, capture_output=True).returncode == 0


def set_up(extra: str) -> None:
    """Make the environment, or update it if it lacks the extra or its recipe has changed.

    The stamp is the fingerprint of the recipe, followed by a word if only the program is installed.
    """
    recipe = [(TOP / name).read_bytes() for name in ("pyproject.toml", "constraints.txt")]
    with_tools = hashlib.sha256(b"".join([str(TOP).encode(), *recipe])).hexdigest()
    program_alone = f"{with_tools} program"
    stamp = VENV / "pfwd-set-up"
    sufficient = [with_tools] if extra else [with_tools, program_alone]
    if PYTHON.exists() and stamp.exists() and stamp.read_text() in sufficient:
        return
    if VENV.exists() and any(VENV.iterdir()) and not (VENV / "pyvenv.cfg").exists():
        sys.exit(f"dev.py: {VENV} is not a virtual environment; name another folder in PFWD_VENV")
    start = time.monotonic()
    if not has_pip():
        print(f"dev.py: making the environment {VENV} (5 to 20 s, no download)", flush=True)
        try:
            venv.create(VENV, with_pip=True)
        except subprocess.CalledProcessError:
            sys.exit("dev.py: Python cannot make environments; Debian: apt install python3-venv")
    install(extra)
    stamp.write_text(with_tools if extra else program_alone)
    print(f"dev.py: set up in {time.monotonic() - start:.0f} s", flush=True)


def tests(arguments: list[str]) -> tuple[bool, str]:
    """Run pytest, show what it prints, and return whether it passed and its counts in words."""
    chosen = [] if "-m" in arguments else ["-m", "not slow"]
    # Parts in order share what a folder's tests need; at the end one takes from the other. There is
    # one worker more than cores, because many tests wait for an instrument or a process.
    workers = ["-n", str(min(6, (os.cpu_count() or 1) + 1)), "--dist", "worksteal"]
    command = [str(PYTHON), "-m", "pytest", *workers, "-q", *chosen, *arguments]
    last = ""
    pipe = {"stdout": subprocess.PIPE, "encoding": "utf-8", "errors": "replace"}
    # Else each of some hundred processes that tests start compiles the program again.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    with subprocess.Popen(command, cwd=TOP, env=environment, **pipe) as process:
        for line in process.stdout or ():
            print(line, end="", flush=True)
            last = line if line.strip() else last
    count = {word.rstrip("s"): int(number) for number, word in re.findall(r"(\d+) ([a-z]+)", last)}
    failed = count.get("failed", 0) + count.get("error", 0)
    words = f"{count.get('passed', 0)} passed, {failed} failed, {count.get('skipped', 0)} skipped"
    return process.returncode == 0, words


def main(arguments: list[str]) -> int:
    if "--python" in arguments:
        place = arguments.index("--python")
        version = "".join(arguments[place + 1 : place + 2])
        if not re.fullmatch(r"3\.\d+(\.\d+)?", version):
            sys.exit(f"dev.py: --python: expected a version like 3.13, got {version or 'none'}")
        return with_python(version, [*arguments[:place], *arguments[place + 2 :]])
    task = arguments[0] if arguments else ""
    if task not in ("demo", "test", "check", "docs", "app", "release", "mutate"):
        print(__doc__)
        return 2
    set_up("" if task == "demo" else "dev")
    if task == "demo":
        if os.name != "nt":  # the demo takes this process over, so that signals reach it directly
            os.execv(BIN / "pfwd", ["pfwd", "demo", *arguments[1:]])
        return run(["pfwd", "demo", *arguments[1:]])
    if task == "docs":
        install("docs")
        return run(["python", "-m", "mkdocs", "build", "--strict"])
    if task == "app":
        install("app")
        return run(["python", ".ci/app.py"])
    if task == "release":
        install("release")
        return run(["python", ".ci/release.py", *arguments[1:]])
    if task == "mutate":
        install("mutate")
        return run(["python", ".ci/mutate.py", *arguments[1:]])
    with ThreadPoolExecutor(2) as pool:
        ok = dict(zip(STATIC_CHECKS, pool.map(passes, STATIC_CHECKS.values()), strict=True))
    passed, words = tests(arguments[1:]) if task == "test" else (True, "")
    good, bad = ([n for n in ok if ok[n] == wanted] for wanted in (True, False))
    parts = [words, good and ", ".join(good) + " ok", bad and ", ".join(bad) + " FAILED"]
    verdict = passed and not bad
    print("PASSED" if verdict else "FAILED", "; ".join(filter(None, parts)), flush=True)
    return 0 if verdict else 1


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit("dev.py: interrupted")
