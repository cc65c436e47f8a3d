"""Container and installer contain the wheel and the program folder."""

import re
import tomllib
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]
INSTALLERS = TOP / "installers"
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_container_is_built_from_the_content_of_the_wheel() -> None:
    text = (INSTALLERS / "Dockerfile").read_text(encoding="utf-8")
    copied = {
        name for line in re.findall(r"^COPY (?!--)(.*)$", text, re.M) for name in line.split()[:-1]
    }
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {*wheel["packages"], *wheel["force-include"], "pyproject.toml", "constraints.txt"}
    needed |= {PROJECT["project"]["readme"], *PROJECT["project"]["license-files"]}
    assert copied == needed
    assert all((TOP / name).exists() for name in copied)


def test_the_container_has_the_oldest_supported_python() -> None:
    text = (INSTALLERS / "Dockerfile").read_text(encoding="utf-8")
    versions = set(re.findall(r"^FROM python:([\d.]+)-slim", text, re.M))
    assert versions == {PROJECT["project"]["requires-python"].removeprefix(">=")}


def test_the_installer_packs_the_folder_of_the_program() -> None:
    text = (INSTALLERS / "windows.iss").read_text(encoding="utf-8")
    assert r"..\dist\pfwd\*" in text
    assert f"/DVersion={PROJECT['project']['version']}" in text
    from_app = (TOP / ".ci" / "app.py").read_text(encoding="utf-8")
    assert '"dist"' in from_app


def test_the_installer_changes_the_path_in_both_directions() -> None:
    """Its entry is removed with the program, and an empty PATH gets no semicolon."""
    text = (INSTALLERS / "windows.iss").read_text(encoding="utf-8")
    assert "{olddata}" not in text
    assert re.search(r"CurStep = ssPostInstall\)[^;]*ChangePath\(True\)", text)
    assert re.search(r"CurUninstallStep = usUninstall[^;]*ChangePath\(False\)", text)
    assert re.search(r"if Changed <> '' then\s+Changed := Changed \+ ';'", text)
