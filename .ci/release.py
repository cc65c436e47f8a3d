"""Builds what a release consists of, and tries it: ``python3 dev.py release [--check]``.

    dist/release   wheel, source archive, site, software bill of materials, manifests for winget and
                   conda-forge, SHA256SUMS

A release stops if a field that a manifest needs is missing. With ``--check`` the field is listed
instead, and its place in the manifest holds its name. ``--finish`` builds nothing: it fills the
manifests again and computes the checksums, after the installers that Windows and macOS have built
were added to the folder. It needs Python alone.
"""

import hashlib
import importlib.metadata
import shutil
import subprocess
import sys
import tomllib
import venv
from functools import reduce
from pathlib import Path
from string import Template
from typing import Any

import app

TOP = app.TOP
FILES, TRIALS = TOP / "dist" / "release", TOP / "build" / "release"
FIELDS = {
    "repository": "project.urls.Repository",
    "winget_identifier": "tool.release.winget-identifier",
    "conda_maintainers": "tool.release.conda-maintainers",
}
"""Field of pyproject.toml that a variable of a manifest stands for."""

CONDA_NAMES = {"matplotlib": "matplotlib-base", "typst": "typst-py"}
"""Name on conda-forge of a package that has another one there."""

SKIPPED = """\
SKIPPED the one-folder program of this system: python3 dev.py app builds it and tries it
SKIPPED program and installer for Windows: they need Windows; .ci/windows tries them with wine
SKIPPED package for macOS: it needs macOS"""


class Release:
    """Version, fields and file names of the release that a pyproject.toml describes."""

    def __init__(self, top: Path, files: Path) -> None:
        self.top, self.files = top, files
        self.toml: dict[str, Any] = tomllib.loads((top / "pyproject.toml").read_text("utf-8"))
        self.project: dict[str, Any] = self.toml["project"]
        self.name = f"{self.project['name']}-{self.project['version']}"
        self.source = files / f"{self.name}.tar.gz"
        self.wheel = files / f"{self.name}-py3-none-any.whl"
        self.installer = files / f"{self.name}-windows.exe"

    def field(self, path: str) -> str:
        """Return a field of pyproject.toml, lists with commas; if it is missing, an empty text."""
        value: Any = reduce(lambda table, key: table.get(key, {}), path.split("."), self.toml)
        return ", ".join(value) if isinstance(value, list) else str(value or "")

    def missing(self, *, finished: bool) -> list[str]:
        """Return the names of what is missing for a release, with or without its installers."""
        names = [f"{path} in pyproject.toml" for path in FIELDS.values() if not self.field(path)]
        version = self.project["version"]
        if f"\n## [{version}]" not in (self.top / "CHANGELOG.md").read_text("utf-8"):
            names.append(f"section [{version}] in CHANGELOG.md")
        tags = subprocess.run(
            ["git", "tag", "--points-at", "HEAD"], cwd=self.top, capture_output=True, text=True
        )
        if f"v{version}" not in tags.stdout.split():
            names.append(f"tag v{version} on this commit")
        if finished and not self.installer.exists():
            names.append(self.installer.name)
        return names

    def values(self) -> dict[str, str]:
        """Return the variables of the manifests; for a missing one, its name in angle brackets."""
        values = {name: self.field(path) or f"<{path}>" for name, path in FIELDS.items()}
        for variable, file in (("source", self.source), ("installer", self.installer)):
            values[variable] = file.name
            values[f"{variable}_sha256"] = sha256(file) if file.exists() else f"<{file.name}>"
        values |= {name: self.project[name] for name in ("version", "description", "license")}
        values["publisher"] = self.project["authors"][0]["name"]
        values["python"] = self.project["requires-python"].removeprefix(">=")
        values["entry_point"] = " = ".join(*self.project["scripts"].items())
        for variable, requirements in (
            ("build_requirements", self.toml["build-system"]["requires"]),
            ("run_requirements", self.project["dependencies"]),
        ):
            values[variable] = "\n".join(map(conda_requirement, requirements))
        return values

    def fill_manifests(self) -> None:
        """Write the manifests for winget and conda-forge from the templates in installers."""
        identifier = self.field(FIELDS["winget_identifier"]) or self.project["name"]
        values = self.values()
        for template in sorted((self.top / "installers").glob("*/*.yaml")):
            text = Template(template.read_text("utf-8")).substitute(values)
            # winget expects the identifier in the names of its three files
            name = template.name.replace("winget", identifier)
            (self.files / name).write_text(text, encoding="utf-8")

    def write_checksums(self) -> None:
        """Write the checksums of all files of the release, as sha256sum reads them."""
        sums = self.files / "SHA256SUMS"
        sums.unlink(missing_ok=True)
        lines = [f"{sha256(file)}  {file.name}\n" for file in sorted(self.files.iterdir())]
        sums.write_text("".join(lines), encoding="utf-8")

    def build(self) -> None:
        """Build wheel, source archive and site."""
        shutil.rmtree(self.files, ignore_errors=True)
        shutil.rmtree(TRIALS, ignore_errors=True)
        python = (sys.executable, "-m")
        # The wheel is built from the source archive, so that both are complete.
        app.call(*python, "build", "--no-isolation", "--outdir", self.files, self.top)
        app.call(*python, "twine", "check", "--strict", self.wheel, self.source)
        app.call(*python, "mkdocs", "build", "--quiet", "--strict", "--site-dir", TRIALS / "site")
        shutil.make_archive(str(self.files / f"{self.name}-site"), "zip", TRIALS / "site")

    def write_bill(self, environment: Path) -> None:
        """Write the software bill of materials of an environment, in CycloneDX's format."""
        command = (sys.executable, "-m", "cyclonedx_py", "environment", "--output-reproducible")
        bill = self.files / f"{self.name}.cdx.json"
        options = ("--pyproject", self.top / "pyproject.toml", "--of", "JSON", "-o", bill)
        app.call(*command, *options, scripts_of(environment) / "python")


def sha256(file: Path) -> str:
    """Return the checksum of a file in hexadecimal digits."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def conda_requirement(requirement: str) -> str:
    """Return a line of the recipe for a requirement as ``numpy>=2.0,<3``."""
    name, sign, versions = requirement.partition(">=")
    return f"    - {CONDA_NAMES.get(name, name)} {sign}{versions}"


def scripts_of(environment: Path) -> Path:
    """Return the folder of the programs of an environment."""
    return environment / ("Scripts" if sys.platform == "win32" else "bin")


def install(package: Path, environment: Path) -> None:
    """Install a package into an environment that holds nothing else, not even pip."""
    venv.create(environment, clear=True)
    pip = (sys.executable, "-m", "pip", "--python", environment, "install", "--quiet")
    options = ("--no-compile", "--disable-pip-version-check", "-c", "constraints.txt")
    app.call(*pip, *options, package)


def print_sizes(environment: Path) -> None:
    """Print the size of an environment and of the largest packages in it."""
    (packages,) = environment.glob("[Ll]ib/**/site-packages")
    sizes = {
        distribution.name: sum(
            Path(str(file.locate())).stat().st_size
            for file in distribution.files or ()
            if Path(str(file.locate())).is_file() and file.suffix != ".pyc"
        )
        for distribution in importlib.metadata.distributions(path=[str(packages)])
    }
    largest = sorted(sizes, key=lambda name: -sizes[name])[:9]
    parts = ", ".join(f"{name} {sizes[name] / 1e6:.0f}" for name in largest)
    print(f"  installed: {sum(sizes.values()) / 1e6:.0f} MB: {parts}", flush=True)


def try_packages(release: Release) -> None:
    """Install wheel and source archive, each into an empty environment, and run the program."""
    beginning = app.alone([Path(sys.prefix)])
    if beginning is None:
        print("SKIPPED closing off network and tools in the trials: it needs root or Linux")
    for package, name in ((release.source, "source"), (release.wheel, "wheel")):
        environment = TRIALS / name
        install(package, environment)
        print_sizes(environment)
        app.try_commands([*(beginning or []), scripts_of(environment) / "pfwd"], with_screen=False)
    docker = shutil.which("docker")
    if docker and subprocess.run([docker, "info"], capture_output=True).returncode == 0:
        app.call(docker, "build", "--quiet", "-f", "installers/Dockerfile", "-t", "pfwd", TOP)
        app.call(docker, "run", "--rm", "pfwd", "--version")
    else:
        print("SKIPPED container: it needs docker, which must be running")
    print(SKIPPED, flush=True)


def main(arguments: list[str]) -> int:
    """Build, try, fill and sum up."""
    release = Release(TOP, FILES)
    check, finish = "--check" in arguments, "--finish" in arguments
    missing = release.missing(finished=check or finish)
    if missing and not check:
        sys.exit(f"release: expected {'; '.join(missing)}; got none. Add it, then start again")
    if not finish:
        release.build()
        try_packages(release)
        release.write_bill(TRIALS / "wheel")
    release.fill_manifests()
    release.write_checksums()
    for file in sorted(release.files.iterdir()):
        print(f"  {file.name}: {file.stat().st_size / 1e6:.2f} MB")
    for name in missing:
        print(f"MISSING for a release: {name}")
    print("PASSED release", *arguments, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
