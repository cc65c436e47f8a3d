"""Sets up the environment and runs the program or its checks; needs nothing but Python 3.11.

    python3 dev.py demo [ARGS]   set up if needed, then `pfwd demo ARGS`
    python3 dev.py test [ARGS]   set up if needed, then every check and the everyday tests; ARGS
                                 go to pytest (-m "" for the slow tests as well)
    python3 dev.py check         set up if needed, then the static checks alone
    python3 dev.py docs          set up if needed, then the site, strictly, into the folder site
    python3 dev.py app           set up if needed, then the program in one folder and a folder of
                                 wheels, for computers without Python or network; both are tried
    python3 dev.py mutate MODULE [ARGS]  set up if needed, then change MODULE and see whether its
                                 tests notice; ARGS as in .ci/mutate.py

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
import venv
from pathlib import Path

if sys.version_info < (3, 11):
    sys.exit("dev.py: expected Python 3.11 or later, came " + sys.version.split()[0])

TOP = Path(__file__).resolve().parent
VENV = Path(os.environ.get("PFWD_VENV") or TOP / ".venv").resolve()
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
STATIC_CHECKS = {
    "ruff": ["ruff", "check", "."],
    "format": ["ruff", "format", "--check", "."],
    "mypy": ["mypy"],
    # The other systems cannot be run everywhere, but what does not exist there can be found.
    "mypy for Windows": ["mypy", "--platform", "win32", "--cache-dir", ".mypy_cache/win32"],
    "mypy for macOS": ["mypy", "--platform", "darwin", "--cache-dir", ".mypy_cache/darwin"],
    # They are in no wheel, and some of them are for one system alone.
    "mypy for benchmarks": [
        "mypy",
        "-p",
        "benchmarks",
        "--platform",
        "linux",
        "--cache-dir",
        ".mypy_cache/benchmarks",
    ],
    "imports": ["lint-imports"],
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
    sys.exit(f"dev.py: --python: expected a Python {version} on this computer, came none")


def with_python(version: str, arguments: list[str]) -> int:
    """Let another Python do it, in an environment of its own."""
    environment = {"PFWD_VENV": str(TOP / f".venv-{version}"), **os.environ}
    return subprocess.call([find_python(version), __file__, *arguments], env=environment)


def run(command: list[str]) -> int:
    print("+", *command, flush=True)
    return subprocess.call([str(BIN / command[0]), *command[1:]], cwd=TOP)


def install(extra: str) -> None:
    """Put the checkout with an extra of it into the environment."""
    pip = ["python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if run([*pip, "-c", "constraints.txt", "-e", f".[{extra}]"]) != 0:
        sys.exit("dev.py: the packages could not be installed; pip says why above")


def set_up() -> None:
    """Make the environment, or bring it up to date when what it is made from has changed."""
    recipe = [(TOP / name).read_bytes() for name in ("pyproject.toml", "constraints.txt")]
    fingerprint = hashlib.sha256(b"".join([str(TOP).encode(), *recipe])).hexdigest()
    stamp = VENV / "pfwd-set-up"
    if PYTHON.exists() and stamp.exists() and stamp.read_text() == fingerprint:
        return
    if VENV.exists() and any(VENV.iterdir()) and not (VENV / "pyvenv.cfg").exists():
        sys.exit(f"dev.py: {VENV} is not a virtual environment; name another folder in PFWD_VENV")
    if not PYTHON.exists():
        print(f"making {VENV}", flush=True)
        try:
            venv.create(VENV, with_pip=True)
        except subprocess.CalledProcessError:
            sys.exit("dev.py: Python cannot make environments; Debian: apt install python3-venv")
    install("dev")
    stamp.write_text(fingerprint)


def tests(arguments: list[str]) -> tuple[bool, str]:
    """Run pytest, show what it prints, and return whether it passed and its counts in words."""
    chosen = [] if "-m" in arguments else ["-m", "not slow"]
    # Halves in order share what a folder's tests need; at the end one takes from the other.
    workers = ["-n", "2", "--dist", "worksteal"]
    command = [str(PYTHON), "-m", "pytest", *workers, "-q", *chosen, *arguments]
    last = ""
    pipe = {"stdout": subprocess.PIPE, "encoding": "utf-8", "errors": "replace"}
    with subprocess.Popen(command, cwd=TOP, **pipe) as process:
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
            sys.exit(f"dev.py: --python: expected a version like 3.13, came {version or 'none'}")
        return with_python(version, [*arguments[:place], *arguments[place + 2 :]])
    task = arguments[0] if arguments else ""
    if task not in ("demo", "test", "check", "docs", "app", "mutate"):
        print(__doc__)
        return 2
    set_up()
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
    if task == "mutate":
        install("mutate")
        return run(["python", ".ci/mutate.py", *arguments[1:]])
    ok = {name: run(command) == 0 for name, command in STATIC_CHECKS.items()}
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
