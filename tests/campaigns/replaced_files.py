"""Replacement, deletion and damage of the files of a survey while `pfwd log` records it.

Programs that synchronise folders, restore backups or edit files write a copy and rename it over the
original. A program that has the original open continues to write into a file without a name.
"""

import contextlib
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pfwd_device.errors import RecordingError
from pfwd_device.jobs import Jobs
from pfwd_device.recording import recover
from tests.campaigns.judge import REPLACED, Event, Outcome
from tests.campaigns.log_process import (
    MAX_SESSION_S,
    N_DROPS,
    Command,
    add_other_surveys,
    log_command,
    recover_and_check,
    separate_environment,
)

N_LATER_DROPS = 4
"""Number of drops, saved or refused, between the replacement and the end of the session."""

QUIET_S = 0.4
"""Time without drops, s, in which a session without its folder may warn."""


@dataclass
class Scene:
    """Survey that is being recorded, and what was done to its files."""

    folder: Path
    """Folder of the trial."""
    survey: Path
    older: Path
    """Copy of the survey before the last drops."""
    rng: np.random.Generator
    url: str
    """URL of a second instrument."""
    other_places: list[Path] = field(default_factory=list)
    """Folders that may contain the survey, or a part of its drops."""
    other_loggers: list[Command] = field(default_factory=list)
    """Loggers besides the first."""
    descriptors: list[int] = field(default_factory=list)
    """File descriptors to close at the end."""
    undo: list[Callable[[], None]] = field(default_factory=list)
    """Functions that make the survey readable again."""

    @property
    def segment(self) -> Path:
        """Segment of the journal that is being written."""
        return sorted((self.survey / "journal").glob("*.pfwdj"))[-1]

    @property
    def ledger(self) -> Path:
        """Ledger of the acknowledged drops."""
        return self.survey / "acknowledged.txt"

    @property
    def lock(self) -> Path:
        """Lock of the survey."""
        return self.survey / "survey.lock"


def _replace_file(path: Path, content: bytes | None = None) -> None:
    """Rename a copy, or other content, over a file, as programs do that synchronise folders."""
    draft = path.with_name(f".{path.name}.sync")
    draft.write_bytes(path.read_bytes() if content is None else content)
    os.replace(draft, path)


def _replace_all(scene: Scene) -> None:
    for path in sorted(scene.survey.rglob("*")):
        if path.is_file():
            with contextlib.suppress(FileNotFoundError):  # a renamed draft
                _replace_file(path)


def _replace_drop_file(scene: Scene) -> None:
    for path in sorted((scene.survey / "drops").glob("*.h5"))[:1]:
        _replace_file(path, b"another file")


def _delete_content(scene: Scene) -> None:
    for path in list(scene.survey.iterdir()):
        _remove(path)


def _remove(path: Path) -> None:
    """Remove a file or folder, repeatedly if files are created meanwhile."""
    for _ in range(20):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        if not path.exists():
            return


def _move_folder(scene: Scene) -> None:
    target = scene.folder / "moved"
    scene.survey.rename(target)
    scene.other_places.append(target)


def _move_parent(scene: Scene) -> None:
    target = scene.folder / "moved-parent"
    scene.survey.parent.rename(target)
    scene.other_places.append(target / scene.survey.name)


def _move_and_copy(scene: Scene) -> None:
    """Rename the folder, and put a copy in its place."""
    _move_folder(scene)
    shutil.copytree(scene.other_places[-1], scene.survey)


def _move_and_link(scene: Scene) -> None:
    """Move the folder, and put a link in its place: no drop is lost."""
    _move_folder(scene)
    scene.survey.symlink_to(scene.other_places[-1], target_is_directory=True)
    scene.other_places.pop()


def _link_to_copy(scene: Scene) -> None:
    """Copy and delete the folder, as between two disks, and put a link in its place."""
    target = scene.folder / "copied"
    shutil.copytree(scene.survey, target)
    _remove(scene.survey)
    scene.survey.symlink_to(target, target_is_directory=True)


def _truncate(scene: Scene, path: Path) -> None:
    os.truncate(path, int(path.stat().st_size * scene.rng.uniform(0.2, 0.9)))


def _overwrite(scene: Scene, path: Path) -> None:
    """Write random bytes into a file, whose length stays as it is."""
    size = path.stat().st_size
    length = int(scene.rng.integers(1, max(2, size // 4)))
    with path.open("r+b") as stream:
        stream.seek(int(scene.rng.integers(0, size - length + 1)))
        stream.write(scene.rng.bytes(length))


def _append(path: Path, data: bytes) -> None:
    with path.open("ab") as stream:
        stream.write(data)


def _restore_files(scene: Scene, write: Callable[[Path, bytes], object]) -> None:
    """Restore a backup of journal and ledger, by rename or in place."""
    for path in (scene.segment, scene.ledger):
        backup = scene.older / path.relative_to(scene.survey)
        if backup.exists():
            write(path, backup.read_bytes())


def _older_folder(scene: Scene) -> None:
    """Restore a backup of the folder."""
    _remove(scene.survey)
    shutil.copytree(scene.older, scene.survey)


def _second_logger(scene: Scene) -> None:
    """Remove the lock, and start a second logger."""
    scene.lock.unlink()
    log = log_command(scene.url, scene.survey, "--point", "second")
    scene.other_loggers.append(Command(log, separate_environment(scene.folder)))


def _recover_meanwhile(scene: Scene) -> None:
    """Remove the lock, and recover the files that are being written."""
    scene.lock.unlink()
    with contextlib.suppress(RecordingError):
        recover(scene.survey, jobs=Jobs(0))


def _relock(scene: Scene) -> None:
    """Replace the lock, and hold it as another program."""
    import fcntl  # not on Windows, where this module is imported and not used

    _replace_file(scene.lock)
    descriptor = os.open(scene.lock, os.O_RDWR)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    scene.descriptors.append(descriptor)


def _forbid(scene: Scene, path: Path) -> None:
    before = path.stat().st_mode
    path.chmod(0o000)
    scene.undo.append(lambda: path.chmod(before))


def _read_only(scene: Scene) -> None:
    """Remove the right to write from folders and files."""
    paths = [scene.survey, *scene.survey.rglob("*")]
    modes = {path: path.stat().st_mode for path in paths if path.exists()}
    for path, mode in modes.items():
        with contextlib.suppress(FileNotFoundError):
            path.chmod(mode & ~0o222)

    def allow() -> None:
        for path, mode in modes.items():
            with contextlib.suppress(FileNotFoundError):
                path.chmod(mode)

    scene.undo.append(allow)


def _unmount(scene: Scene) -> None:
    """Unmount the disk lazily, as a desktop does: its files live on without a path."""
    subprocess.run(["umount", "-l", str(scene.survey.parent)], check=True, capture_output=True)


def _mount(path: Path) -> None:
    command = ["mount", "-t", "tmpfs", "-o", "size=40m", "pfwd", str(path)]
    subprocess.run(command, check=True, capture_output=True)


def _unmount_all(path: Path) -> None:
    while os.path.ismount(path):
        subprocess.run(["umount", str(path)], check=True, capture_output=True)


def _link_all(scene: Scene) -> None:
    """Make a backup of hard links; no file is replaced."""
    shutil.copytree(scene.survey, scene.folder / "links", copy_function=os.link)


def _read_all(scene: Scene) -> None:
    """Read and touch files; no file is replaced."""
    for path in scene.survey.rglob("*"):
        with contextlib.suppress(OSError):
            if path.is_file():
                path.read_bytes()
    os.utime(scene.survey)
    os.utime(scene.segment)


@dataclass(frozen=True, slots=True)
class Replacement:
    """Entry of `REPLACEMENTS`."""

    replace: Callable[[Scene], object]
    """Function that changes the files of a survey."""
    removes: bool = False
    """True if the survey, or a part of it, is no longer in its place."""
    harmless: bool = False
    """True if no drop is endangered, so that a warning is wrong."""
    mounted: bool = False
    """True if the survey needs a separate disk, which only an administrator can mount."""


REPLACEMENTS: Mapping[str, Replacement] = {
    "journal replaced": Replacement(lambda s: _replace_file(s.segment)),
    "ledger replaced": Replacement(lambda s: _replace_file(s.ledger)),
    "lock replaced": Replacement(lambda s: _replace_file(s.lock)),
    "all files replaced": Replacement(_replace_all),
    "drop file replaced": Replacement(_replace_drop_file),
    "journal deleted": Replacement(lambda s: s.segment.unlink(), removes=True),
    "ledger deleted": Replacement(lambda s: s.ledger.unlink(), removes=True),
    "lock deleted": Replacement(lambda s: s.lock.unlink()),
    "folder journal deleted": Replacement(lambda s: _remove(s.survey / "journal"), removes=True),
    "folder drops deleted": Replacement(lambda s: _remove(s.survey / "drops")),
    "folder log deleted": Replacement(lambda s: _remove(s.survey / "log")),
    "content deleted": Replacement(_delete_content, removes=True),
    "survey deleted": Replacement(lambda s: _remove(s.survey), removes=True),
    "survey moved": Replacement(_move_folder, removes=True),
    "parent moved": Replacement(_move_parent, removes=True),
    "survey moved and copied": Replacement(_move_and_copy, removes=True),
    "survey moved, linked": Replacement(_move_and_link, harmless=True),
    "survey copied, linked": Replacement(_link_to_copy),
    "journal truncated": Replacement(lambda s: _truncate(s, s.segment)),
    "journal emptied": Replacement(lambda s: os.truncate(s.segment, 0)),
    "ledger truncated": Replacement(lambda s: _truncate(s, s.ledger)),
    "journal written over in place": Replacement(lambda s: _overwrite(s, s.segment)),
    "ledger written over in place": Replacement(lambda s: _overwrite(s, s.ledger)),
    "garbage in the journal": Replacement(
        lambda s: _append(s.segment, s.rng.bytes(int(s.rng.integers(1, 5000))))
    ),
    "garbage in the ledger": Replacement(lambda s: _append(s.ledger, b"a line of text\n")),
    "older copies by rename": Replacement(lambda s: _restore_files(s, _replace_file)),
    "older copies in place": Replacement(lambda s: _restore_files(s, Path.write_bytes)),
    "older folder": Replacement(_older_folder),
    "second logger": Replacement(_second_logger),
    "recovered meanwhile": Replacement(_recover_meanwhile),
    "lock held by another": Replacement(_relock),
    "survey forbidden": Replacement(lambda s: _forbid(s, s.survey)),
    "journal forbidden": Replacement(lambda s: _forbid(s, s.survey / "journal")),
    "parent forbidden": Replacement(lambda s: _forbid(s, s.survey.parent)),
    "read-only": Replacement(_read_only),
    "disk unmounted": Replacement(_unmount, removes=True, mounted=True),
    "disk mounted over": Replacement(lambda s: _mount(s.survey)),
    "backup of hard links": Replacement(_link_all, harmless=True),
    "backup read": Replacement(_read_all, harmless=True),
}

NEED_MOUNT = ("disk unmounted", "disk mounted over")


def impossible() -> dict[str, str]:
    """Return the replacements that this machine cannot make, with the reason."""
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            names = ("survey forbidden", "journal forbidden", "parent forbidden", "read-only")
            return dict.fromkeys(names, "an administrator may write everywhere; setpriv is missing")
        return {}
    return dict.fromkeys(NEED_MOUNT, "only an administrator can mount")


def _without_override() -> list[str]:
    """Return a command that removes the right of an administrator to write everywhere."""
    if os.geteuid() != 0:
        return []
    rights = "-dac_override,-dac_read_search"
    return ["setpriv", "--bounding-set", rights, "--inh-caps", rights]


def trial(
    urls: tuple[str, str], folder: Path, name: str, rng: np.random.Generator, *, killed: bool
) -> Outcome:
    """Run `pfwd log`, replace its files, and return the outcome."""
    replacement = REPLACEMENTS[name]
    survey = folder / "work" / "survey"
    survey.parent.mkdir()
    if replacement.mounted:
        _mount(survey.parent)
    scene = Scene(folder, survey, folder / "older", rng, urls[1])
    outcome = Outcome(removed=replacement.removes)
    command = Command(
        log_command(urls[0], survey), separate_environment(folder), before=_without_override()
    )
    try:
        replaced = _replace(command, scene, replacement, rng)
        drops = max(len(command.handled), 1) + N_LATER_DROPS if replaced else N_DROPS
        for logger in scene.other_loggers:
            logger.report = command.insert
        command.wait_for(drops, MAX_SESSION_S if command.running else 0.0)
        time.sleep(QUIET_S if killed else 0.0)
        for logger in scene.other_loggers:
            logger.wait_for(2, MAX_SESSION_S)
            logger.stop()
            status = logger.wait()
            outcome.later_statuses += (-1 if status is None else status,)
            outcome.output += f"--- second: {logger.text}"
        outcome.killed = killed and command.running
        command.kill() if outcome.killed else command.stop()
        outcome.status = command.wait()
    finally:
        command.kill()
        for descriptor in scene.descriptors:
            os.close(descriptor)
        for undo in scene.undo:
            undo()
    outcome.events = command.events
    outcome.output = f"{command.text}{outcome.output}"
    outcome.harmless = replacement.harmless
    recover_and_check(outcome, survey, folder)
    for place in scene.other_places:
        _add_recovered(outcome, place)
    if os.path.ismount(survey):
        _unmount_all(survey)
        _add_recovered(outcome, survey)  # below the mounted disk
    _unmount_all(survey.parent)
    shutil.rmtree(folder)
    folder.mkdir()
    return outcome


def _replace(
    command: Command, scene: Scene, replacement: Replacement, rng: np.random.Generator
) -> bool:
    """Replace the files between two drops or within one; return False if the session has ended."""
    first = int(rng.integers(1, 3))
    if not command.wait_for(first, MAX_SESSION_S):
        return False
    shutil.copytree(scene.survey, scene.older, ignore=shutil.ignore_patterns("*.tmp", "*.lock"))
    if not command.wait_for(first + int(rng.integers(1, 3)), MAX_SESSION_S):
        return False
    time.sleep(float(rng.uniform(0.0, 0.1)))
    if not command.running:
        return False
    replacement.replace(scene)
    command.insert(Event(REPLACED, ""))
    return True


def _add_recovered(outcome: Outcome, place: Path) -> None:
    with contextlib.suppress(RecordingError):
        recover(place, jobs=Jobs(0))
    add_other_surveys(outcome.recovered, place)
