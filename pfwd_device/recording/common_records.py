"""Fast parsers of the two most frequent records of a survey.

Each drop of a survey has two records of rebounds and three of files. Their JSON differs in the
values only, so a regular expression reads it. Any other text gives None, and the caller parses it
as JSON. The record of a stored result contains the result as one long text, from which recovery
makes the file. The parser reads only what follows that text.
"""

import re
import struct

_NUMBER = rb"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:e[+-]?\d+)?"

_REBOUND = re.compile(
    rb'\{"arrays":\[\{"dtype":"<i4","name":"counts","shape":\[\d{1,9},\d{1,9}\]\}\],"data":'
    rb'\{"delay":%b,"first_sample":(?:0|[1-9]\d{0,17}),"number":([1-9]\d{0,8}),"peak_load":%b\},'
    rb'"packed":(?:true|false)\}' % (_NUMBER, _NUMBER)
)

_FACTS = (
    rb'"number":(null|[1-9]\d{0,8}),"path":"((?:drops|results|captures)/\w[\w.-]{0,99})",'
    rb'"sha256":"([0-9a-f]{64})","size":(0|[1-9]\d{0,14}),"time_utc":"[\dTZ:.+-]{1,40}"\},'
    rb'"packed":false\}'
)
_FILE = re.compile(rb'\{"arrays":\[\],"data":\{' + _FACTS)

_RESULT_HEAD = b'{"arrays":[],"data":{"content":"'
_RESULT = re.compile(re.escape(_RESULT_HEAD))
_RESULT_END = re.compile(rb'",' + _FACTS)
_END_BEGINS = b'","number":'
_ESCAPE = ord("\\")
_RESULT_BEGIN = 4 + len(_RESULT_HEAD)
_LONGEST_END = 400
"""Upper limit of the length of `_FACTS`, bytes."""

_LENGTH = struct.Struct("<I")
"""Length of the JSON, stored before it."""


def parse_common_rebound(payload: memoryview) -> int | None:
    """Return the survey-wide number of the drop that a rebound belongs to."""
    if len(payload) < _LENGTH.size:
        return None
    match = _REBOUND.fullmatch(
        payload, _LENGTH.size, _LENGTH.size + _LENGTH.unpack_from(payload)[0]
    )
    return None if match is None else int(match[1])


def parse_common_file(payload: memoryview) -> tuple[str, int, str, int | None] | None:
    """Return path, size (bytes) and SHA-256 of a file, and the survey-wide number of its drop."""
    size = len(payload)
    if size < _LENGTH.size or _LENGTH.unpack_from(payload)[0] != size - _LENGTH.size:
        return None  # there are no arrays
    match = _FILE.fullmatch(payload, _LENGTH.size)
    if match is None and _RESULT.match(payload, _LENGTH.size) is not None:
        end = bytes(payload[max(_RESULT_BEGIN, size - _LONGEST_END) :])
        at = end.rfind(_END_BEGINS)
        if at > 0 and end[at - 1] != _ESCAPE:  # else the quote is one of the text
            match = _RESULT_END.fullmatch(end, at)
    if match is None:
        return None
    number, path, sha256, length = match.groups()
    drop_number = None if number == b"null" else int(number)
    return str(path, "ascii"), int(length), str(sha256, "ascii"), drop_number
