"""Comparison of texts with files, which ``PFWD_NEW_SNAPSHOTS=1`` writes."""

import os
from pathlib import Path


def check_snapshot(text: str, test_file: str, name: str) -> None:
    """Compare a text with ``snapshots/name.txt`` beside the file of a test."""
    file = Path(test_file).with_name("snapshots") / f"{name}.txt"
    if os.environ.get("PFWD_NEW_SNAPSHOTS"):
        file.parent.mkdir(exist_ok=True)
        file.write_text(text, encoding="utf-8", newline="\n")
    assert text == file.read_text(encoding="utf-8")
