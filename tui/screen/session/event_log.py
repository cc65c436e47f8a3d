"""Events of a session as lines of the log file; the screen has no room for all of them."""

import logging

from pfwd.message_groups import text_of
from pfwd.session.events import (
    DropAnalysed,
    DropNotSaved,
    DropSaved,
    Edited,
    InstrumentLost,
    InstrumentReady,
    NotReady,
    PointBegan,
    Ready,
    Rebounded,
    SensorCheck,
    SessionNotice,
)
from tui.format import drop_line
from tui.screen.session.screen_events import ScreenEvent, SessionEnded

log = logging.getLogger("pfwd.session")


def log_event(event: ScreenEvent) -> None:
    """Write an event to the log; live samples and progress are not logged."""
    match event:
        case InstrumentReady(url, identity, setup):
            log.info("%s %s at %s", identity.model, identity.serial_number, url)
            log.info("plate radius %g m, mass %s kg", setup.plate_radius, setup.plate_mass)
            for text in (*event.differences, *event.warnings):
                log.info("%s", text)
        case InstrumentLost(reason):
            log.warning("instrument lost: %s", reason)
        case NotReady(reason):
            log.warning("not ready: %s", reason)
        case Ready():
            log.info("ready")
        case SensorCheck(details, faults):
            log.info("load cell: zero %s N, span %s", details["zero_n"], details["span_ratio"])
            for fault in faults:
                log.warning("%s", text_of(fault))
        case DropSaved(one):
            log.info("drop %s/%s saved as %s", one.point, one.number, one.record)
            for mark in one.view.marks:
                log.warning("drop %s/%s: %s", one.point, one.number, text_of(mark))
            if one.screening.status == "rejected":
                reason = text_of(one.screening.reason)
                log.info("drop %s/%s rejected: %s", one.point, one.number, reason)
        case DropNotSaved(point, number, reason):
            log.error("drop %s/%s is not safe yet: %s", point, number, reason)
        case DropAnalysed(one, delay, result):
            after = "" if delay is None else f", {delay:.3f} s after its last sample"
            log.info("%s%s", drop_line(one.point, one.number, result), after)
        case Rebounded(point, number, delay, load):
            log.info("rebound of %s/%s after %.3f s, %.0f N", point, number, delay, load)
        case PointBegan(point):
            log.info("point %s", point)
        case Edited(what, value, point, record):
            log.info("%s %s of %s", what, value, point if record is None else f"record {record}")
        case SessionNotice(text, serious, details):
            log.log(logging.WARNING if serious else logging.INFO, "%s", text)
            if details:
                log.error("%s", details)
        case SessionEnded(ending, error):
            log.info("session ended: %s", error or ending)
