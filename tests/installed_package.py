"""Installation of a package into a folder: its modules and metadata."""

from collections.abc import Mapping
from pathlib import Path


def install(
    folder: Path,
    modules: Mapping[str, str],
    entry_points: str,
    name: str = "toy",
    version: str = "0.1",
) -> None:
    """Write modules (source by file name) and entry points (as in entry_points.txt)."""
    for file, source in modules.items():
        target = folder / file
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(source, encoding="utf-8")
    about = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    about.mkdir(parents=True)
    head = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    (about / "METADATA").write_text(head, encoding="utf-8")
    (about / "entry_points.txt").write_text(entry_points, encoding="utf-8")
