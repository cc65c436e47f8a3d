"""The release without a build: missing fields, manifests and checksums of a small project."""

import hashlib
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

TOP = Path(__file__).resolve().parents[1]
WITHOUT_FIELDS = re.sub(
    r"^\[(tool\.release|project\.urls)\]\n(.+\n)*",
    "",
    (TOP / "pyproject.toml").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)
COMPLETE = """
[tool.release]
winget-identifier = "Example.PFWD"
conda-maintainers = ["first", "second"]

[project.urls]
Repository = "https://repository.example/pfwd"
"""


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(str(TOP / ".ci"))
    yield import_module("release")
    for name in ("release", "app"):
        sys.modules.pop(name, None)


@pytest.fixture
def project(release: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Release of a copy of this project with all fields, in a repository with a tagged commit."""
    shutil.copytree(TOP / "installers", tmp_path / "installers")
    (tmp_path / "pyproject.toml").write_text(WITHOUT_FIELDS + COMPLETE, encoding="utf-8")
    version = tomllib.loads(WITHOUT_FIELDS)["project"]["version"]
    (tmp_path / "CHANGELOG.md").write_text(f"# Changes\n\n## [{version}]\n", encoding="utf-8")
    author = ["-c", "user.name=Example", "-c", "user.email=nobody@example.org"]
    for words in (["init", "-q"], ["commit", "-q", "--allow-empty", "-m", "First"]):
        subprocess.run(["git", *author, *words], cwd=tmp_path, check=True)
    subprocess.run(["git", "tag", f"v{version}"], cwd=tmp_path, check=True)
    monkeypatch.setattr(release, "TOP", tmp_path)
    monkeypatch.setattr(release, "FILES", tmp_path / "files")
    (tmp_path / "files").mkdir()
    project = release.Release(tmp_path, tmp_path / "files")
    project.source.write_bytes(b"source")
    return project


def manifest(path: Path) -> Any:
    return YAML(typ="safe").load(path)


@pytest.mark.parametrize(
    ("file", "text", "name"),
    [
        ("pyproject.toml", "Repository", r"project\.urls\.Repository in pyproject.toml"),
        ("pyproject.toml", "winget-identifier", r"tool\.release\.winget-identifier"),
        ("pyproject.toml", "conda-maintainers", r"tool\.release\.conda-maintainers"),
        ("CHANGELOG.md", "## [", r"section \[.*\] in CHANGELOG.md"),
        (".git/refs/tags", "", r"tag v.* on this commit"),
    ],
)
def test_a_release_stops_at_a_missing_field_with_its_name(
    project: Any, release: Any, file: str, text: str, name: str
) -> None:
    path = project.top / file
    if text:
        path.write_text(path.read_text(encoding="utf-8").replace(text, "other"), encoding="utf-8")
    else:
        shutil.rmtree(path)
    with pytest.raises(SystemExit, match=f"^release: expected {name}[^;]*; got none"):
        release.main([])
    assert list(project.files.iterdir()) == [project.source]


def test_the_last_step_of_a_release_stops_without_the_installer(project: Any, release: Any) -> None:
    with pytest.raises(SystemExit, match=r"pfwd-.*-windows\.exe"):
        release.main(["--finish"])


def test_manifests_contain_the_fields_and_checksums(project: Any, release: Any) -> None:
    project.installer.write_bytes(b"installer")
    assert release.main(["--finish"]) == 0
    version = project.project["version"]
    folder = f"https://repository.example/pfwd/releases/download/v{version}"
    files = [f"Example.PFWD{end}.yaml" for end in ("", ".installer", ".locale.en-US")]
    version_part, installer, locale = (manifest(project.files / file) for file in files)
    for part in (version_part, installer, locale):
        assert (part["PackageIdentifier"], part["PackageVersion"]) == ("Example.PFWD", version)
    (entry,) = installer["Installers"]
    assert entry["InstallerUrl"] == f"{folder}/{project.installer.name}"
    assert entry["InstallerSha256"] == hashlib.sha256(b"installer").hexdigest()
    assert locale["ShortDescription"] == project.project["description"]
    recipe = manifest(project.files / "recipe.yaml")
    assert recipe["source"]["url"] == f"{folder}/{project.source.name}"
    assert recipe["source"]["sha256"] == hashlib.sha256(b"source").hexdigest()
    assert recipe["extra"]["recipe-maintainers"] == ["first", "second"]
    assert recipe["build"]["python"]["entry_points"] == ["pfwd = tui.cli:main"]
    assert "numpy >=2.0,<3" in recipe["requirements"]["run"]
    assert len(recipe["requirements"]["run"]) == 1 + len(project.project["dependencies"])


def test_a_missing_field_has_its_name_in_the_manifest(project: Any, release: Any) -> None:
    path = project.top / "pyproject.toml"
    path.write_text(WITHOUT_FIELDS, encoding="utf-8")
    release.Release(project.top, project.files).fill_manifests()
    installer = manifest(project.files / "pfwd.installer.yaml")
    assert installer["PackageIdentifier"] == "<tool.release.winget-identifier>"
    (entry,) = installer["Installers"]
    assert entry["InstallerUrl"].startswith("<project.urls.Repository>/")
    assert entry["InstallerSha256"] == f"<{project.installer.name}>"


def test_every_file_has_a_checksum(project: Any) -> None:
    (project.files / "note.txt").write_bytes(b"note")
    for _ in range(2):  # the list itself is not in it
        project.write_checksums()
    lines = (project.files / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    contents = {"note.txt": b"note", project.source.name: b"source"}
    assert lines == [
        f"{hashlib.sha256(contents[name]).hexdigest()}  {name}" for name in sorted(contents)
    ]


def test_manifest_and_installer_have_equal_names(project: Any) -> None:
    script = (TOP / "installers" / "windows.iss").read_text(encoding="utf-8")
    project.fill_manifests()
    code = manifest(project.files / "Example.PFWD.installer.yaml")["ProductCode"]
    assert f"\nAppId={code.removesuffix('_is1')}\n" in script
    output = project.installer.stem.replace(project.project["version"], "{#Version}")
    assert f"\nOutputBaseFilename={output}\n" in script
