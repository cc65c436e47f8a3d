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
from tests.campaigns.judge import REPLACED, Outcome, Said
from tests.campaigns.log_process import (
    DROPS,
    LONGEST,
    Command,
    add_other_surveys,
    look,
    own_places,
)

AFTER = 4
"""Drops that are saved or refused after the replacement, before the session is told to end."""

SETTLED = 0.4
"""s without any more drops, in which a session that has lost its folder may say so."""


@dataclass
class Scene:
    """A survey that is being recorded, and what was done to it."""

    folder: Path
    """Everything of the trial is below it."""
    survey: Path
    older: Path
    """A copy of the survey as it was some drops ago."""
    rng: np.random.Generator
    url: str
    """Of a second instrument."""
    elsewhere: list[Path] = field(default_factory=list)
    """Where the survey, or a part of its drops, may be now."""
    second: list[Command] = field(default_factory=list)
    """Loggers beside the first."""
    held: list[int] = field(default_factory=list)
    """Descriptors to be closed at the end."""
    undo: list[Callable[[], None]] = field(default_factory=list)
    """What has to be taken back before the survey can be looked at, or removed."""

    def segment(self) -> Path:
        """The segment of the journal that is written now."""
        return sorted((self.survey / "journal").glob("*.pfwdj"))[-1]

    @property
    def ledger(self) -> Path:
        return self.survey / "acknowledged.txt"

    @property
    def lock(self) -> Path:
        return self.survey / "survey.lock"


def _over(path: Path, content: bytes | None = None) -> None:
    """As programs do that never leave half a file: a copy, renamed over the original."""
    draft = path.with_name(f".{path.name}.sync")
    draft.write_bytes(path.read_bytes() if content is None else content)
    os.replace(draft, path)


def _replace_journal(scene: Scene) -> None:
    _over(scene.segment())


def _replace_ledger(scene: Scene) -> None:
    _over(scene.ledger)


def _replace_lock(scene: Scene) -> None:
    _over(scene.lock)


def _replace_all(scene: Scene) -> None:
    for path in sorted(scene.survey.rglob("*")):
        if path.is_file():
            with contextlib.suppress(FileNotFoundError):  # a draft that has become its file
                _over(path)


def _replace_drop_file(scene: Scene) -> None:
    for path in sorted((scene.survey / "drops").glob("*.h5"))[:1]:
        _over(path, b"another file")


def _delete_journal(scene: Scene) -> None:
    scene.segment().unlink()


def _delete_ledger(scene: Scene) -> None:
    scene.ledger.unlink()


def _delete_lock(scene: Scene) -> None:
    scene.lock.unlink()


def _delete_journal_folder(scene: Scene) -> None:
    _remove(scene.survey / "journal")


def _delete_drops_folder(scene: Scene) -> None:
    _remove(scene.survey / "drops")


def _delete_log_folder(scene: Scene) -> None:
    _remove(scene.survey / "log")


def _delete_content(scene: Scene) -> None:
    for path in list(scene.survey.iterdir()):
        _remove(path)


def _delete_all(scene: Scene) -> None:
    _remove(scene.survey)


def _remove(path: Path) -> None:
    """As ``rm -rf``, again where a file came meanwhile."""
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
    scene.elsewhere.append(target)


def _move_parent(scene: Scene) -> None:
    target = scene.folder / "moved-parent"
    scene.survey.parent.rename(target)
    scene.elsewhere.append(target / scene.survey.name)


def _move_and_copy(scene: Scene) -> None:
    """A folder that was renamed, and a copy of it put where it was."""
    _move_folder(scene)
    shutil.copytree(scene.elsewhere[-1], scene.survey)


def _move_and_link(scene: Scene) -> None:
    """A folder that was moved to a larger disk, with a link where it was: nothing is lost."""
    _move_folder(scene)
    scene.survey.symlink_to(scene.elsewhere[-1], target_is_directory=True)
    scene.elsewhere.pop()


def _link_to_copy(scene: Scene) -> None:
    """The same by copying and deleting, as it is done between two disks."""
    target = scene.folder / "copied"
    shutil.copytree(scene.survey, target)
    _remove(scene.survey)
    scene.survey.symlink_to(target, target_is_directory=True)


def _truncate_journal(scene: Scene) -> None:
    path = scene.segment()
    os.truncate(path, int(path.stat().st_size * scene.rng.uniform(0.2, 0.9)))


def _empty_journal(scene: Scene) -> None:
    os.truncate(scene.segment(), 0)


def _truncate_ledger(scene: Scene) -> None:
    os.truncate(scene.ledger, int(scene.ledger.stat().st_size * scene.rng.uniform(0.2, 0.9)))


def _write_over_journal(scene: Scene) -> None:
    """Other bytes in place; the length stays as it is."""
    _write_over(scene, scene.segment())


def _write_over_ledger(scene: Scene) -> None:
    _write_over(scene, scene.ledger)


def _write_over(scene: Scene, path: Path) -> None:
    size = path.stat().st_size
    length = int(scene.rng.integers(1, max(2, size // 4)))
    with path.open("r+b") as stream:
        stream.seek(int(scene.rng.integers(0, size - length + 1)))
        stream.write(scene.rng.bytes(length))


def _garbage_in_journal(scene: Scene) -> None:
    with scene.segment().open("ab") as stream:
        stream.write(scene.rng.bytes(int(scene.rng.integers(1, 5000))))


def _garbage_in_ledger(scene: Scene) -> None:
    with scene.ledger.open("ab") as stream:
        stream.write(b"a line that somebody typed\n")


def _older_by_rename(scene: Scene) -> None:
    """A backup restored by a program that renames."""
    for name in (scene.segment().relative_to(scene.survey), Path(scene.ledger.name)):
        if (scene.older / name).exists():
            _over(scene.survey / name, (scene.older / name).read_bytes())


def _older_in_place(scene: Scene) -> None:
    """A backup restored by a program that writes into the file that is there."""
    for name in (scene.segment().relative_to(scene.survey), Path(scene.ledger.name)):
        if (scene.older / name).exists():
            (scene.survey / name).write_bytes((scene.older / name).read_bytes())


def _older_folder(scene: Scene) -> None:
    """A backup restored as a whole."""
    _remove(scene.survey)
    shutil.copytree(scene.older, scene.survey)


def _second_logger(scene: Scene) -> None:
    """Somebody takes the lock for stale, removes it, and starts again."""
    scene.lock.unlink()
    log = ["log", scene.url, "-o", str(scene.survey), "--point", "second", "--no-invert", "--json"]
    scene.second.append(Command(log, own_places(scene.folder)))


def _recover_meanwhile(scene: Scene) -> None:
    """The same, and recovery is run over the files that are being written."""
    scene.lock.unlink()
    with contextlib.suppress(RecordingError):
        recover(scene.survey, jobs=Jobs(0))


def _relock(scene: Scene) -> None:
    """The lock is replaced and held by another program."""
    import fcntl  # not on Windows, where this module is imported and not used

    _over(scene.lock)
    descriptor = os.open(scene.lock, os.O_RDWR)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    scene.held.append(descriptor)


def _forbid_survey(scene: Scene) -> None:
    _forbid(scene, scene.survey)


def _forbid_journal(scene: Scene) -> None:
    _forbid(scene, scene.survey / "journal")


def _forbid_parent(scene: Scene) -> None:
    _forbid(scene, scene.survey.parent)


def _forbid(scene: Scene, path: Path) -> None:
    before = path.stat().st_mode
    path.chmod(0o000)
    scene.undo.append(lambda: path.chmod(before))


def _read_only(scene: Scene) -> None:
    """Folders and files without the right to write."""
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
    """The disk is taken away (lazily, as a desktop does): its files live on without a path."""
    subprocess.run(["umount", "-l", str(scene.survey.parent)], check=True, capture_output=True)


def _mount_over(scene: Scene) -> None:
    """Another disk appears where the survey is, and stays."""
    _mount(scene.survey)


def _mount(path: Path) -> None:
    command = ["mount", "-t", "tmpfs", "-o", "size=40m", "pfwd", str(path)]
    subprocess.run(command, check=True, capture_output=True)


def _unmount_all(path: Path) -> None:
    while os.path.ismount(path):
        subprocess.run(["umount", str(path)], check=True, capture_output=True)


def _hard_links(scene: Scene) -> None:
    """A backup made of hard links: nothing is replaced."""
    shutil.copytree(scene.survey, scene.folder / "links", copy_function=os.link)


def _read_everything(scene: Scene) -> None:
    """A backup that reads, and a person who looks: nothing is replaced."""
    for path in scene.survey.rglob("*"):
        with contextlib.suppress(OSError):
            if path.is_file():
                path.read_bytes()
    os.utime(scene.survey)
    os.utime(scene.segment())


@dataclass(frozen=True, slots=True)
class Replacement:
    """One thing that is done."""

    do: Callable[[Scene], None]
    takes_away: bool = False
    """Afterwards the survey, or a part of it, is not where it was."""
    harmless: bool = False
    """Nothing is lost by it, so that no warning is wanted."""
    mounted: bool = False
    """The survey is on a disk of its own, which only an administrator can make."""


REPLACEMENTS: Mapping[str, Replacement] = {
    "journal replaced": Replacement(_replace_journal),
    "ledger replaced": Replacement(_replace_ledger),
    "lock replaced": Replacement(_replace_lock),
    "all files replaced": Replacement(_replace_all),
    "drop file replaced": Replacement(_replace_drop_file),
    "journal deleted": Replacement(_delete_journal, takes_away=True),
    "ledger deleted": Replacement(_delete_ledger, takes_away=True),
    "lock deleted": Replacement(_delete_lock),
    "folder journal deleted": Replacement(_delete_journal_folder, takes_away=True),
    "folder drops deleted": Replacement(_delete_drops_folder),
    "folder log deleted": Replacement(_delete_log_folder),
    "content deleted": Replacement(_delete_content, takes_away=True),
    "survey deleted": Replacement(_delete_all, takes_away=True),
    "survey moved": Replacement(_move_folder, takes_away=True),
    "parent moved": Replacement(_move_parent, takes_away=True),
    "survey moved and copied": Replacement(_move_and_copy, takes_away=True),
    "survey moved, linked": Replacement(_move_and_link, harmless=True),
    "survey copied, linked": Replacement(_link_to_copy),
    "journal truncated": Replacement(_truncate_journal),
    "journal emptied": Replacement(_empty_journal),
    "ledger truncated": Replacement(_truncate_ledger),
    "journal written over in place": Replacement(_write_over_journal),
    "ledger written over in place": Replacement(_write_over_ledger),
    "garbage in the journal": Replacement(_garbage_in_journal),
    "garbage in the ledger": Replacement(_garbage_in_ledger),
    "older copies by rename": Replacement(_older_by_rename),
    "older copies in place": Replacement(_older_in_place),
    "older folder": Replacement(_older_folder),
    "second logger": Replacement(_second_logger),
    "recovered meanwhile": Replacement(_recover_meanwhile),
    "lock held by another": Replacement(_relock),
    "survey forbidden": Replacement(_forbid_survey),
    "journal forbidden": Replacement(_forbid_journal),
    "parent forbidden": Replacement(_forbid_parent),
    "read-only": Replacement(_read_only),
    "disk unmounted": Replacement(_unmount, takes_away=True, mounted=True),
    "disk mounted over": Replacement(_mount_over),
    "backup of hard links": Replacement(_hard_links, harmless=True),
    "backup read": Replacement(_read_everything, harmless=True),
}

NEED_MOUNT = ("disk unmounted", "disk mounted over")


def impossible() -> dict[str, str]:
    """Replacements that this machine cannot make, with the reason."""
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            names = ("survey forbidden", "journal forbidden", "parent forbidden", "read-only")
            return dict.fromkeys(names, "an administrator may write everywhere; setpriv is missing")
        return {}
    return dict.fromkeys(NEED_MOUNT, "only an administrator can mount")


def _as_usual_person() -> list[str]:
    """What an administrator's right to write everywhere is taken away with."""
    if os.geteuid() != 0:
        return []
    rights = "-dac_override,-dac_read_search"
    return ["setpriv", "--bounding-set", rights, "--inh-caps", rights]


def trial(
    urls: tuple[str, str], folder: Path, name: str, rng: np.random.Generator, *, killed: bool
) -> Outcome:
    """Run `pfwd log`, replace its files, and return what is found afterwards."""
    replacement = REPLACEMENTS[name]
    survey = folder / "work" / "survey"
    survey.parent.mkdir()
    if replacement.mounted:
        _mount(survey.parent)
    scene = Scene(folder, survey, folder / "older", rng, urls[1])
    outcome = Outcome(gone=replacement.takes_away)
    log = ["log", urls[0], "-o", str(survey), "--no-invert", "--json"]
    command = Command(log, own_places(folder), before=_as_usual_person())
    try:
        done = _replace(command, scene, replacement, rng)
        drops = max(len(command.dealt_with), 1) + AFTER if done else DROPS
        for other in scene.second:
            other.tell = command.note
        command.wait_for(drops, LONGEST if command.running else 0.0)
        time.sleep(SETTLED if killed else 0.0)
        for other in scene.second:
            other.wait_for(2, LONGEST)
            other.stop()
            outcome.later_statuses += (_status(other.wait()),)
            outcome.output += f"--- second: {other.text}"
        outcome.killed = killed and command.running
        command.kill() if outcome.killed else command.stop()
        outcome.status = command.wait()
    finally:
        command.kill()
        for descriptor in scene.held:
            os.close(descriptor)
        for undo in scene.undo:
            undo()
    outcome.said = command.said
    outcome.output = f"{command.text}{outcome.output}"
    outcome.harmless = replacement.harmless
    statuses = outcome.later_statuses
    look(outcome, survey, folder)
    outcome.later_statuses += statuses
    for place in scene.elsewhere:
        _look_elsewhere(outcome, place)
    if os.path.ismount(survey):
        _unmount_all(survey)
        _look_elsewhere(outcome, survey)  # what is below it
    _unmount_all(survey.parent)
    shutil.rmtree(folder)
    folder.mkdir()
    return outcome


def _replace(
    command: Command, scene: Scene, replacement: Replacement, rng: np.random.Generator
) -> bool:
    """Whether the files were replaced, at some moment between two drops or within one."""
    first = int(rng.integers(1, 3))
    if not command.wait_for(first, LONGEST):
        return False
    shutil.copytree(scene.survey, scene.older, ignore=shutil.ignore_patterns("*.tmp", "*.lock"))
    if not command.wait_for(first + int(rng.integers(1, 3)), LONGEST):
        return False
    time.sleep(float(rng.uniform(0.0, 0.1)))
    if not command.running:
        return False
    replacement.do(scene)
    command.note(Said(REPLACED, ""))
    return True


def _status(status: int | None) -> int:
    return -1 if status is None else status


def _look_elsewhere(outcome: Outcome, place: Path) -> None:
    with contextlib.suppress(RecordingError):
        recover(place, jobs=Jobs(0))
    add_other_surveys(outcome.found, place)
