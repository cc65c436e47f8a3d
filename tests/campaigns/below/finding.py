"""The names of what is in a survey, as those name it who acknowledge."""

import contextlib
import json
from pathlib import Path

from pfwd_device.errors import RecordingError
from pfwd_device.recording import read_survey
from tests.campaigns.below.driver import drop_name


def found_names(folder: Path, *, with_content: bool) -> list[str]:
    """Every record of a survey that can be read.

    Parameters
    ----------
    folder : Path
    with_content : bool
        A drop is named with a digest of what is in it, and with it the records about it.

    Raises
    ------
    RecordingError
        If there is no survey, or a drop of it cannot be read.
    """
    survey = read_survey(folder)
    names = []
    for drop in survey.drops:
        record = drop.read()
        if not with_content:
            names.append(f"drop {drop.point}/{drop.drop}")
            continue
        names.append(drop_name(record))
        names += [f"rebound {rebound.first_sample}" for rebound in record.rebounds]
        names += drop.notes
        for path in drop.results:
            try:
                names.append(f"result {json.loads(path.read_bytes())['n']}")
            except OSError:
                continue
    names += [f"event {event['details']['n']}" for event in survey.events if _ours(event)]
    names += [f"check {check['details']['n']}" for check in survey.checks if _ours(check)]
    return names


def add_second_places(names: list[str], folder: Path, *, with_content: bool) -> None:
    """Add what is only in surveys, or parts of surveys, anywhere below a folder."""
    places = sorted({path.parent for path in folder.rglob("journal") if path.is_dir()})
    for place in places:
        with contextlib.suppress(RecordingError):  # what cannot be read is not found
            more = found_names(place, with_content=with_content)
            names += [name for name in more if name not in names]


def _ours(record: dict[str, object]) -> bool:
    details = record.get("details")
    return isinstance(details, dict) and "n" in details
