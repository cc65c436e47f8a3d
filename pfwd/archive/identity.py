"""What makes two runs over an archive the same: the options and the software."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, refusal

FORMAT = 1
"""Of the tables: raised when a column changes, so that new rows do not mix with old ones."""


def software_version(package: str = "pfwd") -> str:
    """The installed version."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def run_identity(options: AnalysisOptions) -> dict[str, Any]:
    """What a result depends on besides its source.

    Raises
    ------
    OptionError
        If the file of ``--header`` cannot be read.
    """
    said = dataclasses.asdict(options)
    header = said.pop("header")
    digest = None
    if header is not None:
        try:
            with open(header, "rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as err:
            came = err.strerror or str(err)
            raise OptionError(refusal(f"--header {header}", "a TOML file", came)) from err
    return {
        "format": FORMAT,
        "software": software_version(),
        "options": said,
        "header_sha256": digest,
    }


def run_key(identity: dict[str, Any]) -> str:
    """Twelve hexadecimal digits that stand for it."""
    text = json.dumps(identity, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
