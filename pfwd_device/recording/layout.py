"""Names of the files of a survey."""

import re
from dataclasses import dataclass
from pathlib import Path

FORMAT_VERSION = 1


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the files of a survey are."""

    folder: Path

    @property
    def journal(self) -> Path:
        return self.folder / "journal"

    @property
    def ledger(self) -> Path:
        return self.folder / "acknowledged.txt"

    @property
    def drops(self) -> Path:
        return self.folder / "drops"

    @property
    def results(self) -> Path:
        return self.folder / "results"

    @property
    def captures(self) -> Path:
        return self.folder / "captures"

    @property
    def damaged(self) -> Path:
        return self.folder / "damaged"

    @property
    def reserve(self) -> Path:
        return self.folder / "reserve"

    @property
    def lock(self) -> Path:
        return self.folder / "survey.lock"

    @property
    def publish_lock(self) -> Path:
        return self.folder / "publish.lock"

    @property
    def writer(self) -> Path:
        return self.folder / "writer.txt"

    @property
    def folders(self) -> tuple[Path, ...]:
        return (self.journal, self.drops, self.results, self.captures, self.damaged)

    def segment(self, number: int) -> Path:
        return self.journal / f"{number:04d}.pfwdj"

    def drop_file(self, number: int) -> Path:
        return self.drops / f"drop-{number:06d}.h5"

    def segments(self) -> list[int]:
        """Numbers of the journal's segments that exist."""
        return sorted(_numbers(self.journal, r"(\d{4,})\.pfwdj"))

    def drop_files(self) -> list[int]:
        """Survey-wide numbers of the drops that have a file."""
        return sorted(_numbers(self.drops, r"drop-(\d{6,})\.h5"))

    def relative(self, path: Path) -> str:
        """Path within the survey as it is written down, with ``/`` on every system."""
        return path.relative_to(self.folder).as_posix()

    def exists(self) -> bool:
        """Whether anything of a survey is in the folder."""
        return bool(self.ledger.exists() or self.segments() or self.drop_files())


def names_in(folder: Path) -> list[str]:
    """Names in a folder, sorted; none when it does not exist."""
    try:
        return sorted(path.name for path in folder.iterdir())
    except OSError:
        return []


def _numbers(folder: Path, pattern: str) -> set[int]:
    matches = (re.fullmatch(pattern, name, re.ASCII) for name in names_in(folder))
    return {int(match[1][:18]) for match in matches if match}
