"""The one word that is read from afar, and what to do next."""

from dataclasses import dataclass
from typing import Literal

from pfwd.judging.stations import next_along, next_name
from pfwd.procedures import Kind, Quantity
from pfwd.session.plan import Ending
from tui.screen.session.state import SessionState
from tui.screen.session.stations import next_station

SAFE_SHOWN = 2.0
"""s that SAFE stays before READY: long enough to look up, shorter than lifting the weight."""

PULSE_SHOWN = 1.5
"""s after a pulse within which its drop has to be found; a knock below the threshold is none."""

FEW_DROPS = 60
"""Ten points: time to make room, and no reason to stop at once."""

REBOUNDS = 1.5
"""s after a drop in which its bounces are looked for; see `DetectionSettings.rebound_window`."""


@dataclass(frozen=True, slots=True)
class StatusWord:
    """What is going on."""

    word: str
    action: str
    """What to do next, or what is waited for."""
    role: Literal["ready", "busy", "alarm"]
    """How it is painted."""


def status_of(
    state: SessionState,
    now: float,
    pulse_age: float | None = None,
    here: tuple[float, float] | None = None,
) -> StatusWord:
    """The state as a word, most urgent first.

    Parameters
    ----------
    state : SessionState
    now : float
        Monotonic clock, s.
    pulse_age : float, optional
        s since the load was last above the threshold; None: it was not.
    here : latitude and longitude in degrees, optional
    """
    for find in (_trouble, _drop_in_hand):
        found = find(state, now, pulse_age)
        if found is not None:
            return found
    return _waiting(state, here)


def _trouble(state: SessionState, now: float, pulse_age: float | None) -> StatusWord | None:
    device = state.device
    if state.held:
        text = f"{_drops(state.held)} only in memory: make room on the disk, leave this open"
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


def _drop_in_hand(state: SessionState, now: float, pulse_age: float | None) -> StatusWord | None:
    last = state.last
    fresh = last is not None and last.came > 0
    bounced = False
    if pulse_age is not None and pulse_age < PULSE_SHOWN:
        # A bounce soon after a drop is no new one: that drop is safe already.
        bounced = fresh and last is not None and now - pulse_age - last.came < REBOUNDS
        if not bounced:
            return StatusWord("DROP", "let it bounce", "busy")
    if not fresh or last is None:
        return None
    age = now - last.came
    if last.waits and state.waits_for_first_modulus:
        return StatusWord("COMPUTING", f"drop {last.number} is on the disk", "busy")
    if last.status == "rejected" and not last.discarded:
        return StatusWord(
            "REPEAT", f"drop {last.number} rejected: {last.reason or 'no result'}", "alarm"
        )
    if last.fault and not last.discarded and state.job.quantity is Quantity.MODULUS:
        return StatusWord("REPEAT", f"drop {last.number} has no modulus: {last.fault}", "alarm")
    if age < SAFE_SHOWN:
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
    whole = progress.seating_wanted + progress.measured_wanted
    return f"drop {last.number} of {whole} on disk" if last.number <= whole else "on disk"


def _waiting(state: SessionState, here: tuple[float, float] | None) -> StatusWord:
    device = state.device
    if state.recorded:
        return StatusWord("REPLAY", "the next recorded drop follows", "busy")
    if state.progress.next_kind is None and state.current_drops:
        return StatusWord("POINT DONE", _where_next(state, here), "ready")
    if state.building is not None:
        part = f"{100 * state.building.fraction:.0f} %"
        return StatusWord("COMPUTING", f"the model's table, once for this plate: {part}", "busy")
    if state.session is None:
        return StatusWord("STARTING", "looking for the instrument", "busy")
    if device.connected and not device.ready:
        return StatusWord(
            "SETTLING", "leave the weight alone: the load at rest is measured", "busy"
        )
    if not device.connected:
        return StatusWord("WAITING", "nothing comes yet", "busy")
    if device.check_faults:
        return StatusWord("CHECK", f"{device.check_faults[0]}", "alarm")
    if state.drops_remaining is not None and state.drops_remaining < FEW_DROPS:
        text = f"room for about {state.drops_remaining} more drops; lift the weight"
        return StatusWord("DISK LOW", text, "alarm")
    return StatusWord("READY", f"lift the weight: {_next(state)}", "ready")


def _where_next(state: SessionState, here: tuple[float, float] | None) -> str:
    job, now = state.job, state.current.shown_name
    names = {point.shown_name for point in state.points.values()}
    coming = next_station(job, names, here, now)
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


def _count(kind: str, done: int, wanted: int | None) -> str:
    whole = "" if wanted is None else f" of {wanted}"
    return f"{kind} drop {done + 1}{whole}"


def _drops(count: int) -> str:
    return "1 drop is" if count == 1 else f"{count} drops are"
