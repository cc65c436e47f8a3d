"""Changes of a drop on the screen by an event."""

from pfwd.analysis.sensor_fits import sensor_fits
from pfwd.judging import DropView
from pfwd.session.events import DropAnalysed, DropSaved, Edited
from tui.screen.session.drop_state import DropState
from tui.screen.session.screen_events import DropRead, Refitted


def saved_drop(event: DropSaved, came: float) -> DropState:
    """Return a drop that is safe now."""
    saved = event.saved
    return DropState(
        saved.point,
        saved.number,
        saved.view,
        status=saved.screening.status,
        reason=saved.screening.reason or "",
        saved=saved,
        identical=event.identical,
        came=came,
    )


def add_answer(drop: DropState, event: DropAnalysed) -> None:
    """A result has come while it is measured."""
    failed = event.result.modulus_pa is None and not event.result.layers
    if failed and drop.results:
        # The quick answer stands: a search that failed takes nothing back.
        drop.final = drop.final or event.final
        return
    drop.results.append(event.result)
    drop.final = drop.final or event.final
    if drop.delay is None:
        drop.delay = event.delay
    if failed:
        drop.fault = event.result.reason or "the analysis failed"
    if event.curves is not None:
        drop.curves = event.curves


def add_read(drop: DropState, event: DropRead) -> None:
    """Its traces and all its results were read from the survey."""
    saved = event.saved
    drop.saved, drop.view = saved, drop.view or saved.view
    main = [result for result in event.results if not result.is_trial]
    if not drop.results:
        drop.status, drop.reason = saved.screening.status, saved.screening.reason or ""
        drop.results = main
    known = {refit.label for refit in drop.refits}
    for result in event.results:
        label = result.refit or ""
        if label and label not in known:
            drop.refits.append(Refitted(saved.point, saved.number, label, result, None))


def add_refit(drop: DropState, event: Refitted) -> None:
    """It was fitted anew, without a fault."""
    if event.label:
        drop.refits = [refit for refit in drop.refits if refit.label != event.label]
        drop.refits.append(event)
    elif event.curves is not None:
        drop.curves = event.curves
        if not drop.results and event.result is not None:
            drop.results.append(event.result)


def add_stored(drop: DropState, stored: DropView) -> None:
    """Take over the stored result of a drop."""
    result = stored.sound_result
    if result is not None and not drop.results:
        drop.results = [result]
        drop.status = result.status or "measured"
        drop.reason = result.reason or ""
    elif result is None and drop.saved is None:
        drop.status, drop.reason = "rejected", "no result; open it to see why"


def sensors_left_out(drop: DropState) -> tuple[int, ...]:
    """Numbers of the sensors, from 1, that take no part in the fit because they cannot be believed.

    As far as that is known: dead ones from the record, others once it is fitted.
    """
    if drop.saved is None:
        return ()
    channels = drop.saved.drop.channels
    gone = set(drop.saved.screening.left_out)
    if drop.curves is not None and len(drop.curves.offsets) > 1:
        gone |= {channel.offset for channel in channels} - set(map(float, drop.curves.offsets))
    return tuple(number for number, channel in enumerate(channels, 1) if channel.offset in gone)


def edit_drop(drop: DropState, event: Edited) -> None:
    """Take back the reason of a restored drop, which may be that it was moved."""
    if event.what == "restore":
        drop.reason = "" if drop.saved is None else drop.saved.screening.reason or ""


def sensor_residuals(drop: DropState) -> dict[int, float]:
    """What the fit leaves of every sensor during the contact, over its peak, by number from 1."""
    if drop.saved is None or drop.curves is None:
        return {}
    numbers = {channel.offset: n for n, channel in enumerate(drop.saved.drop.channels, 1)}
    return {
        numbers[fit.offset]: fit.contact
        for fit in sensor_fits(drop.curves)
        if fit.offset in numbers
    }
