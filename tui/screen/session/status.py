"""Status of the measurement in one word, to be read from metres away, and what to do next."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pfwd.judging.stations import next_along, next_name
from pfwd.procedures import Kind
from pfwd.session.plan import Ending
from tui.screen.session.state import SessionState
from tui.screen.session.stations import next_station

SAFE_WORD_S = 2.0
"""Time that SAFE stays before READY: long enough to look up, shorter than lifting the weight."""

PULSE_WORD_S = 1.5
"""Time after a pulse within which its drop is detected; a knock below the threshold is none."""

LOW_DISK_DROPS = 60
"""Room for ten points: time to free the disk, and no reason to stop at once."""

REBOUND_WINDOW_S = 1.5
"""Time after a drop in which its rebounds are recorded; see `DetectionSettings.rebound_window`."""

WORDS: Mapping[str, str] = {
    "READY": "lift the weight; the next drop is recorded",
    "DROP": "the weight has fallen; let it bounce",
    "SETTLING": "leave the weight alone until READY",
    "COMPUTING": "the drop is safe on the disk, its modulus is being computed",
    "SAFE": "the drop is on the disk",
    "REPEAT": "the drop does not count; make it again",
    "POINT DONE": "all drops of the point are made; walk to the next one",
    "CHECK": "the check of the sensors has found a fault",
    "CABLE OUT": "the instrument does not answer; plug in the cable",
    "NO DEVICE": "no instrument at the port; it is tried again",
    "NOT READY": "the survey cannot be opened; it is tried again",
    "DISK LOW": "make room on the disk",
    "NOT SAFE": "drops are only in memory; make room on the disk, do not leave",
    "STARTING": "looking for the instrument",
    "WAITING": "the instrument sends nothing yet",
    "REPLAY": "a recording is replayed",
    "END": "the session has ended",
    "STOPPED": "the session has ended with an error; stored drops are safe",
    "UNSAVED": "the session has ended with drops that are not on the disk",
    "LOST": "the instrument did not come back; stored drops are safe",
}
"""Status words and their meaning, for the help."""


@dataclass(frozen=True, slots=True)
class StatusWord:
    """Word for the status of the measurement, as READY, with an instruction."""

    word: str
    action: str
    """Instruction: what to do next, or what the program waits for."""
    role: Literal["ready", "busy", "alarm"]
    """Role of the text, for its colours."""


def status_of(
    state: SessionState,
    now: float,
    pulse_age: float | None = None,
    coordinates: tuple[float, float] | None = None,
) -> StatusWord:
    """Return the most urgent status of a session.

    Parameters
    ----------
    state : SessionState
    now : float
        Monotonic clock, s.
    pulse_age : float, optional
        Time since the load was last above the threshold, s; None: never.
    coordinates : latitude and longitude in degrees, optional
    """
    return (
        _trouble(state) or _latest_drop(state, now, pulse_age) or _next_action(state, coordinates)
    )


def _trouble(state: SessionState) -> StatusWord | None:
    device = state.device
    if state.n_unsaved:
        text = f"{_drops(state.n_unsaved)} only in memory: make room on the disk, leave this open"
        return StatusWord("NOT SAFE", text, "alarm")
    if state.files_trouble:
        return StatusWord("NOT SAFE", state.files_trouble, "alarm")
    ended = state.ended
    if ended is not None:
        return _ended(state)
    if state.session is not None and device.lost_reason and not device.connected:
        return StatusWord("CABLE OUT", "plug it in; everything so far is safe", "alarm")
    return None


def _ended(state: SessionState) -> StatusWord:
    ended = state.ended
    assert ended is not None
    if ended.ending is None and ended.retry is not None:
        word = "NO DEVICE" if ended.no_device else "NOT READY"
        return StatusWord(word, f"{ended.error}; trying again", "alarm")
    if ended.ending is None:
        return StatusWord("STOPPED", f"{ended.error}; what was saved is safe", "alarm")
    if ended.ending is Ending.UNSAVED:
        return StatusWord(
            "UNSAVED", "the disk did not take every drop; the log names them", "alarm"
        )
    if ended.ending is Ending.LOST:
        return StatusWord(
            "LOST", "the instrument did not come back; everything so far is safe", "alarm"
        )
    return StatusWord("END", "nothing more comes; look at the points (2), or leave (q)", "ready")


def _latest_drop(state: SessionState, now: float, pulse_age: float | None) -> StatusWord | None:
    last = state.last
    fresh = last is not None and state.saved_at > 0
    bounced = False
    if pulse_age is not None and pulse_age < PULSE_WORD_S:
        # A rebound soon after a drop is no new drop: that drop is stored already.
        bounced = fresh and last is not None and now - pulse_age - state.saved_at < REBOUND_WINDOW_S
        if not bounced:
            return StatusWord("DROP", "let it bounce", "busy")
    if not fresh or last is None:
        return None
    age = now - state.saved_at
    if last.awaits_modulus:
        return StatusWord("COMPUTING", f"drop {last.number} is on the disk", "busy")
    if last.status == "rejected" and not last.discarded:
        return StatusWord(
            "REPEAT", f"drop {last.number} rejected: {last.reason or 'no result'}", "alarm"
        )
    if last.fault and not last.discarded and state.job.quantity.is_fitted:
        return StatusWord("REPEAT", f"drop {last.number} has no modulus: {last.fault}", "alarm")
    if age < SAFE_WORD_S:
        return StatusWord("SAFE", _safe_text(state), "ready")
    if bounced:
        return StatusWord("SETTLING", "let it bounce", "busy")
    return None


def _safe_text(state: SessionState) -> str:
    last = state.last
    assert last is not None
    progress = state.progress
    if progress.seating_wanted is None or progress.measured_wanted is None:
        return f"drop {last.number} on disk"
    total = progress.seating_wanted + progress.measured_wanted
    return f"drop {last.number} of {total} on disk" if last.number <= total else "on disk"


def _next_action(state: SessionState, coordinates: tuple[float, float] | None) -> StatusWord:
    device = state.device
    if state.recorded:
        return StatusWord("REPLAY", "the next recorded drop follows", "busy")
    if state.progress.next_kind is None and state.current.drops:
        return StatusWord("POINT DONE", _where_next(state, coordinates), "ready")
    if state.building is not None:
        part = f"{100 * state.building.fraction:.0f} %"
        return StatusWord("COMPUTING", f"the model's table, once for this plate: {part}", "busy")
    if state.session is None:
        return StatusWord("STARTING", "looking for the instrument", "busy")
    if device.connected and device.not_ready_reason:
        return StatusWord("NOT READY", device.not_ready_reason, "alarm")
    if device.connected and not device.ready:
        return StatusWord(
            "SETTLING", "leave the weight alone: the load at rest is measured", "busy"
        )
    if not device.connected:
        return StatusWord("WAITING", "nothing comes yet", "busy")
    if device.check_faults:
        return StatusWord("CHECK", f"{device.check_faults[0]}", "alarm")
    if state.drops_remaining is not None and state.drops_remaining < LOW_DISK_DROPS:
        text = f"room for about {state.drops_remaining} more drops; lift the weight"
        return StatusWord("DISK LOW", text, "alarm")
    return StatusWord("READY", f"lift the weight: {_next(state)}", "ready")


def _where_next(state: SessionState, coordinates: tuple[float, float] | None) -> str:
    job, now = state.job, state.current.shown_name
    names = {point.shown_name for point in state.points.values()}
    coming = next_station(job, names, coordinates, now)
    if coming is not None:
        return f"{coming.text}; there press n"
    if job.stations:
        return "walk to the next point and press n; the last station of the list is done"
    if job.step_m is not None and next_along(now, job.step_m) is not None:
        return f"next: {next_name(now, names, job.step_m)}, {job.step_m:g} m ahead; there press n"
    return "walk to the next point and press n"


def _next(state: SessionState) -> str:
    progress = state.progress
    if progress.next_kind is Kind.SEATING:
        return _count("seating", progress.seating_done, progress.seating_wanted)
    return _count("measured", progress.measured_done, progress.measured_wanted)


def _count(kind: str, count: int, total: int | None) -> str:
    return f"{kind} drop {count + 1}" + ("" if total is None else f" of {total}")


def _drops(count: int) -> str:
    return "1 drop is" if count == 1 else f"{count} drops are"
