"""Surveys in one file (``NAME.pfwdz``): a zip archive of the folder of a survey.

The archive begins with the member ``pfwd-survey.json``. It lists size and SHA-256 of each file of
the survey, in the order of the other members. The members are not compressed, because journal, drop
files and photos are compressed already; therefore a hostile archive cannot become larger when it is
unpacked. A survey in one file is unpacked to a temporary folder and read there. It is never
changed.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import stat
import tempfile
import weakref
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pfwd.errors import SurveyError, quote, refusal
from pfwd.files.folders import MANIFEST, is_survey_file, refuse_no_survey
from pfwd.files.foreign.archive import BoundedReads
from pfwd_device.recording import Survey, read_survey
from pfwd_device.recording.drop_file import software_version
from pfwd_device.recording.files import file_facts, now
from pfwd_device.recording.layout import Layout, refuse_links
from pfwd_device.recording.payload import decode_json
from pfwd_device.text import clean

SURVEY_FILE_VERSION = 1

MAX_LIST_BYTES = 16 * 2**20
"""Largest list of files, and largest directory of an archive, bytes: about 100,000 files, ten for
each drop of the largest survey. Python takes ten times as much memory for a directory."""

_CHUNK_BYTES = 1 << 20
_NAME = r"(?!(?i:con|prn|aux|nul|com\d|lpt\d)\b)[\w%+=,()~-](?:[\w%+=,()~. -]*[\w%+=,()~-])?"
_FILE_PATTERN = re.compile(
    r"acknowledged\.txt|journal/\d{4,}\.pfwdj|drops/drop-\d{6,}\.h5|results/[a-z]+-\d{6,}-\d+\.json"
    rf"|(?:captures|damaged|photos/{_NAME})/{_NAME}",
    re.ASCII,
)
"""Paths of the files of a survey. None leads out of its folder, and every system accepts them."""


def write_survey_file(path: str | os.PathLike[str], survey: Survey) -> list[str]:
    """Write the files of a survey into one file.

    Another program may be recording into the survey; what it adds meanwhile is omitted.

    Returns
    -------
    list of str
        Descriptions of files that differ from the journal, and of omitted files.

    Raises
    ------
    SurveyError, RecordingError
        If a file cannot be read, or the survey contains a link or too many files.
    """
    layout = Layout(survey.folder)
    refuse_links(layout)
    names, omitted = _files_of(layout)
    try:
        # The ledger is the first file: records after its last line were not acknowledged then.
        files = [file_facts(layout, layout.folder / name) for name in names]
        manifest = {
            "format": "pfwd-survey",
            "format_version": SURVEY_FILE_VERSION,
            "pfwd_version": software_version(),
            "survey_id": survey.survey_id,
            "exported_utc": now(),
            "files": files,
        }
        text = json.dumps(manifest)
        if len(text) > MAX_LIST_BYTES:
            expected = "at most about 100,000 files of a survey"
            raise SurveyError(refusal(survey.path, expected, str(len(names))))
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(zipfile.ZipInfo(MANIFEST), text)
            for listed in files:
                _add(archive, layout.folder / listed["path"], listed)
    except FileNotFoundError as err:
        actual = f"a survey that changed: {err.filename} is gone"
        raise SurveyError(refusal(survey.path, "the files of a survey", actual)) from err
    stored = {(listed["path"], listed["size"], listed["sha256"]) for listed in files}
    damaged = [
        f"{listed.path} is damaged or missing; pfwd recover restores it"
        for listed in survey.listed_files
        if (listed.path, listed.size, listed.sha256) not in stored
    ]
    return [*damaged, *(f"{name} is left out: no file of a survey" for name in omitted)]


def _files_of(layout: Layout) -> tuple[list[str], list[str]]:
    """Return the paths of the files of a survey, and those of unknown files in its folders."""
    names, unknown = [layout.relative(layout.ledger)], list[str]()
    for folder in (*layout.folders, layout.folder / "photos"):
        for parent, folders, files in os.walk(folder):
            folders.sort()
            for name in sorted(files):
                path = layout.relative(Path(parent, name))
                known = _FILE_PATTERN.fullmatch(path) and not os.path.islink(Path(parent, name))
                if not name.startswith("."):  # a draft, which another program is writing
                    (names if known else unknown).append(path)
    return [name for name in names if (layout.folder / name).exists()], unknown


def _add(archive: zipfile.ZipFile, file: Path, listed: dict[str, Any]) -> None:
    """Add the part of a file to an archive that its entry in the manifest describes."""
    member = zipfile.ZipInfo.from_file(file, listed["path"], strict_timestamps=False)
    member.file_size = remaining = listed["size"]
    digest = hashlib.sha256()
    with file.open("rb") as source, archive.open(member, "w") as target:
        while chunk := source.read(min(_CHUNK_BYTES, remaining)):
            digest.update(chunk)
            target.write(chunk)
            remaining -= len(chunk)
    if digest.hexdigest() != listed["sha256"]:
        raise SurveyError(refusal(str(file), "a file that stays as it is", "a change", "try again"))


def read_survey_file(path: str | os.PathLike[str]) -> Survey:
    """Read a survey in one file; its temporary folder is removed with the returned object.

    Raises
    ------
    SurveyError, RecordingError
        If the file is damaged or has another format version, or its survey cannot be read.
    """
    folder = _unpacked(path)
    try:
        survey = read_survey(folder)
    except BaseException:
        _remove(folder, os.getpid())
        raise
    survey.path = os.fspath(path)
    weakref.finalize(survey, _remove, folder, os.getpid())
    return survey


@contextlib.contextmanager
def survey_folder(path: str | os.PathLike[str]) -> Iterator[str]:
    """Yield the folder of a survey; for one in one file a temporary folder, removed after the
    block.

    Raises
    ------
    SurveyError
        If the path is neither, or the file is damaged.
    """
    if not is_survey_file(path):
        refuse_no_survey(path)
        yield os.fspath(path)
        return
    folder = _unpacked(path)
    try:
        yield os.fspath(folder)
    finally:
        _remove(folder, os.getpid())


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # a copy of the process must not remove it
        shutil.rmtree(folder.parent, ignore_errors=True)


def _unpacked(path: str | os.PathLike[str]) -> Path:
    """Unpack a survey in one file to a temporary folder; return the folder of the survey in it."""
    file = os.fspath(path)
    parent = Path(tempfile.mkdtemp(prefix="pfwd-"))
    name = "".join(c if c.isalnum() or c in " _+-" else "_" for c in Path(path).stem)[:60].strip()
    folder = parent / (name or "survey")
    try:
        size = os.stat(path).st_size
        room = shutil.disk_usage(parent).free
        if size > room:
            expected = f"room for {size} bytes in the folder {parent.parent} for temporary files"
            raise SurveyError(refusal(file, expected, f"{room} bytes", "set TMPDIR"))
        with BoundedReads(file, MAX_LIST_BYTES) as stream, zipfile.ZipFile(stream) as archive:
            for member, checksum in _members(archive, file, size):
                _unpack(archive, member, checksum, folder / member.filename)
    except BaseException as err:
        _remove(folder, os.getpid())
        if isinstance(err, SurveyError) or not isinstance(err, Exception):
            raise
        # zipfile documents no errors for damaged archives.
        actual = err.strerror if isinstance(err, OSError) else f"damage: {err}"
        hint = "copy or export it again; pfwd recover repairs what an archive program unpacks"
        expected = "an intact survey in one file"
        raise SurveyError(refusal(file, expected, clean(str(actual)), hint)) from err
    return folder


def _members(archive: zipfile.ZipFile, file: str, size: int) -> list[tuple[zipfile.ZipInfo, str]]:
    """Return the members of an archive with their SHA-256; refuse what this program never writes.

    Any error of this function is reported as damage, unless it is a `SurveyError`.
    """
    members = archive.infolist()
    # Members that share their bytes could unpack to more than the archive.
    if sum(member.file_size for member in members) > size:
        raise ValueError("members that are longer than the file")
    for member in members:
        is_file = stat.S_IFMT(member.external_attr >> 16) in (0, stat.S_IFREG)
        is_plain = member.compress_type == zipfile.ZIP_STORED and not member.flag_bits & 1
        if not (is_file and is_plain and member.compress_size == member.file_size):
            raise ValueError(f"{member.filename} is compressed, encrypted or no file")
    if not members or members[0].filename != MANIFEST:
        raise ValueError(f"no list of files, {MANIFEST}, at its begin")
    manifest = decode_json(archive.read(members[0]))
    if (version := manifest["format_version"]) != SURVEY_FILE_VERSION:
        expected = f"format version {SURVEY_FILE_VERSION} of a survey in one file"
        raise SurveyError(refusal(file, expected, quote(str(version))))
    checksums = {}
    for member, listed in zip(members[1:], manifest["files"], strict=True):
        path = listed["path"]
        if not _FILE_PATTERN.fullmatch(path) or path.lower() in checksums:
            raise ValueError(f"a file that does not belong to a survey, or twice: {path}")
        if (member.orig_filename, member.file_size) != (path, listed["size"]):
            raise ValueError(f"{path} with other content than in the list")
        checksums[path.lower()] = str(listed["sha256"])
    return list(zip(members[1:], checksums.values(), strict=True))


def _unpack(archive: zipfile.ZipFile, member: zipfile.ZipInfo, checksum: str, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256()
    with archive.open(member) as source, target.open("xb") as stream:
        while chunk := source.read(_CHUNK_BYTES):
            digest.update(chunk)
            stream.write(chunk)
    if digest.hexdigest() != checksum:
        raise ValueError(f"{member.filename} differs from its SHA-256")
