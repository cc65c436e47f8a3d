"""Runs the session in a thread of its own; what it tells waits in a mailbox until it is drawn."""

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from pfwd.errors import DeviceError, RecordingError, SurveyError
from pfwd.session.events import LiveSamples, Notice, SessionEvent
from pfwd.session.live_trace import LiveTrace
from tui.screen.session.screen_events import ScreenEvent, SessionBegan, SessionEnded
from tui.screen.session.sources import SessionSource

log = logging.getLogger("pfwd.screen")

RETRY = 2.0
"""s until a port that could not be opened is tried again."""


class SessionRunner:
    """A session in a thread.

    Parameters
    ----------
    source : SessionSource
    """

    def __init__(self, source: SessionSource) -> None:
        self.source = source
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
        """Whether there is a session, or will be when the port opens."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def waiting(self) -> int:
        """Events that nobody has taken yet."""
        return len(self._mailbox)

    def also_tell(self, listener: Callable[[ScreenEvent], None]) -> None:
        """Tell another one every event but samples, in the session's thread: the log."""
        self._listeners.append(listener)

    def start(self) -> None:
        """Begin; nothing happens while it runs."""
        if self.running:
            return
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)
        self._thread.start()

    def stop(self, timeout: float | None = None) -> bool:
        """End the session when the drop in hand is safe; whether it has ended in time."""
        self._stopping.set()
        session = self._session
        if session is not None:
            session.stop()
        if self._thread is not None:
            self._thread.join(timeout)
        return not self.running

    def ask(self, request: Callable[[Any], None]) -> bool:
        """Have something done in the session's thread; whether there is a session."""
        session = self._session
        if session is None:
            return False
        session.ask(request)
        return True

    def trigger(self) -> bool:
        """Record a drop now; whether there is a session."""
        session = self._session
        if session is not None:
            session.trigger()
        return session is not None

    def put(self, event: ScreenEvent) -> None:
        """Add an event from elsewhere; from any thread."""
        self._mailbox.append(event)

    def take(self) -> list[ScreenEvent]:
        """What has come since."""
        found = []
        while self._mailbox:
            found.append(self._mailbox.popleft())
        return found

    def _run(self) -> None:
        while True:
            ended = self._once()
            self._tell(ended)
            if ended.retry is None or self._stopping.wait(ended.retry):
                return

    def _once(self) -> SessionEnded:
        try:
            ending = self.source.run(self._listen, self._attached)
        except RecordingError as err:
            # Room on the disk may be made, another program may let go of the survey.
            return SessionEnded(None, str(err), None if self._stopping.is_set() else RETRY)
        except DeviceError as err:
            # The cable is not in yet, or another program has the port: both pass.
            retry = RETRY if self.source.url and not self._stopping.is_set() else None
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
        self._session = session
        self._tell(SessionBegan(session, session.point if self.source.writes else ""))
        if self._stopping.is_set():
            session.stop()
        yield

    def _listen(self, event: SessionEvent) -> None:
        if isinstance(event, LiveSamples):
            self._watch(event)
            return
        self._tell(event)

    def _tell(self, event: ScreenEvent) -> None:
        self._mailbox.append(event)
        for listener in self._listeners:
            try:
                listener(event)
            except Exception:  # whoever listens must not end a measurement
                log.exception("a listener failed")

    def _watch(self, event: LiveSamples) -> None:
        try:
            self.trace.feed(event)
            peak = self.trace.last_peak()
        except Exception as err:  # a display must not end a measurement
            log.exception("the live trace failed")
            text = f"the live trace failed: {type(err).__name__}"
            self._mailbox.append(Notice(text, serious=True))
            return
        if peak > event.drop_load:
            self.pulse_at = time.monotonic()
