"""Read the journal of a survey with the standard library and numpy alone.

The format is described in docs/recording.md. Usage: python read_journal.py SURVEY
"""

import json
import struct
import sys
import zlib
from pathlib import Path

import numpy as np

MAGIC = b"\x89PFWDJ\r\n"
HEADER = struct.Struct("<8s2I16sQ2I")  # magic, size, type, survey, sequence, two CRC-32
DROP = 3


def read_records(survey):
    """Return {sequence: (type, data, arrays)} of all undamaged records; a later copy wins."""
    records = {}
    for segment in sorted(Path(survey, "journal").glob("*.pfwdj")):
        content, start = segment.read_bytes(), 0
        while (start := content.find(MAGIC, start)) >= 0 and start + HEADER.size <= len(content):
            _, size, kind, _, sequence, *checks = HEADER.unpack_from(content, start)
            payload = content[start + HEADER.size : start + HEADER.size + size]
            if checks == [zlib.crc32(payload), zlib.crc32(content[start : start + 44])]:
                records[sequence] = (kind, *read_payload(payload))
                start += HEADER.size + size
            else:
                start += 1  # damaged: go on at the next magic
    return records


def read_payload(payload):
    """Return the data of a record, and its arrays by name."""
    end = 4 + int.from_bytes(payload[:4], "little")
    text = json.loads(payload[4:end])
    packed = zlib.decompress(payload[end:]) if text["packed"] else payload[end:]
    arrays, start = {}, 0
    for entry in text["arrays"]:
        count = int(np.prod(entry["shape"]))
        values = np.frombuffer(packed, entry["dtype"], count, start)
        arrays[entry["name"]] = values.reshape(entry["shape"])
        start += values.nbytes
    return text["data"], arrays


if __name__ == "__main__":
    for kind, data, arrays in read_records(sys.argv[1]).values():
        if kind == DROP and "load" in arrays:
            peak = (arrays["load"] - arrays["load"][arrays["time"] < 0].mean()).max()
            print(f"point {data['point']}, drop {data['drop']}: peak load {peak / 1e3:.2f} kN")
