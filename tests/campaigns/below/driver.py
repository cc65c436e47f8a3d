"""Records with the real `SurveyWriter` on files that fail, many times a second.

A process is started on the library of :mod:`tests.campaigns.below.shim`, imports everything once
and then answers requests, each in a fork of its own: the fault is armed in the fork, the survey is
opened, drops, rebounds, notes, events, checks, results and a capture are saved, and every
acknowledgement is a line in a file outside the survey.

Requests are lines of JSON on standard input, ``{"do", "fault", "survey", "out", "seed", ...}``; an
answer is ``{"status": N or null}``, null: it hung and was ended.
"""

import ctypes
import json
import logging
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pfwd_device.errors import RecordingError
from pfwd_device.recording import (
    DropRecord,
    PublishingFailed,
    Rebound,
    SpareFolder,
    Storage,
    SurveyWriter,
    check,
    recover,
)
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.publishing import InlinePublisher
from tests.campaigns.below.planted import plant
from tests.campaigns.power_loss import make_record

LONGEST = float(os.environ.get("PFWD_BELOW_LONGEST", "90"))
"""s that a request may take; it takes a tenth of one."""

RESERVE = 65_536
"""Bytes held back; the usual two million would only cost time."""

SAMPLES = 48


def nth_record(number: int, seed: int) -> DropRecord:
    """The drop with this number, always the same one."""
    return make_record(number, np.random.default_rng([seed, number]), SAMPLES)


def drop_name(record: DropRecord) -> str:
    """What a drop is called by those who judge: its place and what is in it."""
    bare = DropRecord(
        record.point, record.drop, record.counts, record.declared, record.metadata, ()
    )
    return f"drop {record.point}/{record.drop.number} {drop_digest(bare, 0)[:12]}"


class Teller:
    """Writes what happens, one line of JSON each, at once."""

    def __init__(self, path: str) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def say(self, what: str, name: str) -> None:
        """One line."""
        line = json.dumps({"what": what, "name": name}) + "\n"
        os.write(self._descriptor, line.encode("ascii"))


class _Warnings(logging.Handler):
    """What the recording logs is what a program would say."""

    def __init__(self, teller: Teller) -> None:
        super().__init__(logging.WARNING)
        self._teller = teller

    def emit(self, record: logging.LogRecord) -> None:
        self._teller.say("said", record.getMessage())


class Workload:
    """A session in small: every kind of record, one drop after the other."""

    def __init__(self, request: dict[str, Any], teller: Teller) -> None:
        self._request = request
        self._teller = teller
        self._writer: SurveyWriter | None = None
        self._seed = int(request["seed"])

    def run(self) -> None:
        """Open, save, close; a drop that is refused is tried once more, as a session would."""
        first, drops = int(self._request["first"]), int(self._request["drops"])
        storage = Storage()
        writer = SurveyWriter.open(
            self._request["survey"],
            publisher=InlinePublisher(storage),
            reserve_bytes=RESERVE,
            spare=spare_folder(self._request),
        )
        self._writer = writer
        capture = self._try("capture", lambda: writer.open_capture("link", {"url": "none"}))
        for number in range(first, first + drops):
            record = nth_record(number, self._seed)
            saved = self._try(drop_name(record), lambda: writer.save_drop(record))  # noqa: B023
            if saved is None:
                saved = self._try(drop_name(record), lambda: writer.save_drop(record))  # noqa: B023
            if saved is not None:
                self._say_more(writer, saved, number)
            if capture is not None:
                capture.write("from", bytes(200))
        if self._request.get("killed"):
            os._exit(0)
        writer.close()
        self._tell_reports()

    def _tell_reports(self) -> None:
        """What happened to the files comes before the next acknowledgement."""
        for report in self._writer.take_reports() if self._writer is not None else ():
            text = report.reason if isinstance(report, PublishingFailed) else report.text
            self._teller.say("said", text)

    def _say_more(self, writer: SurveyWriter, saved: int, number: int) -> None:
        rebound = Rebound(0.4, 900.0 + number, number, np.full((4, 3), number, np.int32))
        self._try(f"rebound {number}", lambda: writer.save_rebound(saved, rebound))
        self._try(f"note {number}", lambda: writer.edit("note", f"note {number}", number=saved))
        self._try(f"event {number}", lambda: writer.note_event("gap", {"n": number}))
        self._try(f"check {number}", lambda: writer.save_check({"n": number}))
        self._try(f"result {number}", lambda: writer.save_result(saved, {"n": number}))
        writer.publish(saved)

    def _try(self, name: str, save: Callable[[], Any]) -> Any:
        try:
            done = save()
            self._tell_reports()
        except RecordingError as err:
            self._tell_reports()
            self._teller.say("refused", f"{name}: {err}")
            return None
        except OSError as err:
            if name != "capture":
                raise
            self._teller.say("refused", f"{name}: {err}")
            return None
        if name != "capture":
            self._teller.say("acknowledged", name)
        return True if done is None else done


def spare_folder(request: dict[str, Any]) -> SpareFolder | None:
    """The second place for what the survey's folder does not take, where a request names one."""
    return SpareFolder(Path(request["spare"])) if request.get("spare") else None


def _do(request: dict[str, Any], teller: Teller) -> int:
    try:
        if request["do"] == "record":
            Workload(request, teller).run()
        elif request["do"] == "recover":
            report = recover(
                request["survey"],
                publisher=InlinePublisher(Storage()),
                spare=spare_folder(request),
            )
            teller.say("whole" if report.ok else "not whole", "; ".join(report.damaged))
        else:
            found = check(request["survey"], spare=spare_folder(request))
            teller.say("whole" if found.ok else "not whole", "; ".join(found.damaged))
    except RecordingError as err:
        teller.say("refused", str(err))
        return 1
    except Exception:
        # Without the usual heads, which would read as a traceback of the command.
        lines = traceback.format_exc().splitlines()
        teller.say("escaped", "\n".join(line for line in lines if "Traceback" not in line))
        return 1
    return 0


def _in_fork(request: dict[str, Any]) -> int | None:
    """Exit status of the fork that does what is asked, negative after a signal."""
    child = os.fork()
    if child == 0:
        teller = Teller(request["out"])
        log = logging.getLogger("pfwd_device")
        log.addHandler(_Warnings(teller))
        if ctypes.CDLL(None).pfwd_below_arm(os.fsencode(request["fault"])) != 0:
            os._exit(99)
        os._exit(_do(request, teller))
    until = time.monotonic() + LONGEST
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def main() -> int:
    """Answer until the input ends."""
    # What a fork would have to import, it would import through faults.
    import pfwd_device.recording.publisher  # noqa: F401

    plant()
    for line in sys.stdin:
        print(json.dumps({"status": _in_fork(json.loads(line))}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
