"""Session in a thread of its own; its events wait in a mailbox until they are drawn."""

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from pfwd.errors import DeviceError, RecordingError, SurveyError
from pfwd.judging import SurveyView
from pfwd.session.events import LiveSamples, SessionEvent, SessionNotice, SurveyChanged
from pfwd.session.live_trace import LiveTrace
from pfwd.session.live_view import apply_event
from tui.screen.session.screen_events import ScreenEvent, SessionEnded, SessionStarted
from tui.screen.session.sources import SessionSource

log = logging.getLogger("pfwd.screen")

PORT_RETRY_S = 2.0
"""Time until a port that could not be opened is tried again, s."""


class SessionRunner:
    """Runs a session in a thread and collects its events for the screen.

    Parameters
    ----------
    source : SessionSource
    view : SurveyView, optional
        Survey before the first session.
    """

    def __init__(self, source: SessionSource, view: SurveyView | None = None) -> None:
        self.source = source
        self._view = view or SurveyView()
        """Survey as it was published last; the next session continues it."""
        self._lock = threading.Lock()
        self.trace = LiveTrace()
        self._mailbox: deque[ScreenEvent] = deque()
        self._thread: threading.Thread | None = None
        self._session: Any = None
        self._stopping = threading.Event()
        self._listeners: list[Callable[[ScreenEvent], None]] = []
        self.pulse_at: float | None = None
        """Monotonic clock when the load was last above the threshold, s."""

    @property
    def running(self) -> bool:
        """True while a session runs, or waits for its port to open."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def waiting(self) -> int:
        """Number of events in the mailbox."""
        return len(self._mailbox)

    def add_listener(self, listener: Callable[[ScreenEvent], None]) -> None:
        """Call a listener with every event but samples, in the session's thread."""
        self._listeners.append(listener)

    def start(self) -> None:
        """Start the session, unless it runs already."""
        if self.running:
            return
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)
        self._thread.start()

    def stop(self, timeout: float | None = None) -> bool:
        """End the session when the current drop is stored; return whether it ended in time."""
        self._stopping.set()
        session = self._session
        if session is not None:
            session.stop()
        if self._thread is not None:
            self._thread.join(timeout)
        return not self.running

    def request(self, action: Callable[[Any], None]) -> bool:
        """Have the session's thread call an action with the session; False without a session."""
        session = self._session
        if session is None:
            return False
        session.ask(action)
        return True

    def trigger(self) -> bool:
        """Record a drop now, without a trigger by the load; False without a session."""
        session = self._session
        if session is not None:
            session.trigger()
        return session is not None

    def put(self, event: ScreenEvent) -> None:
        """Add an event to the mailbox; may be called from any thread."""
        self._mailbox.append(event)

    def report(self, event: SessionEvent) -> None:
        """Have the session apply an event of the screen to the survey; may be called from any
        thread.

        Without a session the event is applied here, by the function that the session uses.
        """
        with self._lock:
            if self._session is not None:
                self._session.ask(lambda session: session.report(event))
                return
            self._send(event)
            change = apply_event(self._view, event)
            if change is not None:
                self._send(change)

    def take(self) -> list[ScreenEvent]:
        """Return the events in the mailbox and empty it."""
        events = []
        while self._mailbox:
            events.append(self._mailbox.popleft())
        return events

    def _run(self) -> None:
        while True:
            ended = self._once()
            self._send(ended)
            if ended.retry is None or self._stopping.wait(ended.retry):
                return

    def _once(self) -> SessionEnded:
        try:
            ending = self.source.run(self._listen, self._attached)
        except RecordingError as err:
            # The disk may get room again, another program may close the survey.
            return SessionEnded(None, str(err), None if self._stopping.is_set() else PORT_RETRY_S)
        except DeviceError as err:
            # The cable is not plugged in yet, or another program uses the port.
            retry = PORT_RETRY_S if self.source.url and not self._stopping.is_set() else None
            return SessionEnded(None, str(err), retry, no_device=True)
        except SurveyError as err:
            return SessionEnded(None, str(err))
        except OSError as err:
            text = f"{err.filename or 'input or output'}: {err.strerror or err}"
            return SessionEnded(None, text)
        except Exception as err:
            log.exception("the session failed")
            text = f"an unexpected error: {type(err).__name__}: {err} (more in the log)"
            return SessionEnded(None, text)
        finally:
            self._session = None
        return SessionEnded(ending)

    @contextlib.contextmanager
    def _attached(self, session: Any) -> Iterator[None]:
        with self._lock:
            session.continue_survey(self._view)
            self._session = session
        self._send(SessionStarted(session, session.point if self.source.writes else ""))
        if self._stopping.is_set():
            session.stop()
        yield

    def _listen(self, event: SessionEvent) -> None:
        if isinstance(event, LiveSamples):
            self._watch(event)
            return
        self._send(event)

    def _send(self, event: ScreenEvent) -> None:
        if isinstance(event, SurveyChanged):
            self._view = event.view
        self._mailbox.append(event)
        for listener in self._listeners:
            try:
                listener(event)
            except Exception:  # a listener must not end a measurement
                log.exception("a listener failed")

    def _watch(self, event: LiveSamples) -> None:
        try:
            self.trace.feed(event)
            peak = self.trace.last_peak()
        except Exception as err:  # a display must not end a measurement
            log.exception("the live trace failed")
            text = f"the live trace failed: {type(err).__name__}"
            self._mailbox.append(SessionNotice(text, serious=True))
            return
        if peak > event.drop_load:
            self.pulse_at = time.monotonic()
