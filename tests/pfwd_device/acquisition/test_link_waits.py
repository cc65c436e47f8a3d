"""Waits of the reading thread between two attempts to open a port, and its queue."""

from typing import Any

import pytest

from pfwd_device.acquisition.items import Counters
from pfwd_device.acquisition.link import Chunk, Link, Lost, Queue, WakeUp, _now
from pfwd_device.errors import DeviceLost, PortError
from pfwd_device.wire.dialect import LinkCounters


class Ended:
    """An event that is set after some waits, and keeps how long they were."""

    def __init__(self, count: int) -> None:
        self.waits: list[float] = []
        self._count = count

    def wait(self, seconds: float) -> bool:
        self.waits.append(seconds)
        return self.is_set()

    def is_set(self) -> bool:
        return len(self.waits) >= self._count

    def set(self) -> None:
        self._count = 0


def absent() -> Any:
    raise PortError("no such port")


def test_a_missing_port_is_tried_at_growing_intervals() -> None:
    counters = Counters(link=LinkCounters())
    queue = Queue(10_000, counters)
    link = Link(absent, queue)
    ended = Ended(8)
    link._stop = ended  # type: ignore[assignment]
    link._run()
    assert ended.waits == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 2.0])
    lost = [queue.get(0.0) for _ in range(8)]
    assert all(isinstance(event, Lost) and not event.was_open for event in lost)
    link.drop(object(), "a port that was closed before")  # type: ignore[arg-type]
    assert queue.get(0.0) is None
    # Once the right instrument answered it is looked for at once.
    link.settled()
    link._stop = ended = Ended(1)  # type: ignore[assignment]
    link._run()
    assert ended.waits == [0.1]


class Unplugged:
    """A port whose cable was pulled: writing fails."""

    is_open = True

    def write(self, data: bytes) -> None:
        raise DeviceLost("the cable was pulled")

    def close(self) -> None:
        self.is_open = False


def test_a_port_that_cannot_be_written_is_closed() -> None:
    port: Any = Unplugged()
    link = Link(absent, Queue(1000, Counters(link=LinkCounters())))
    link._transport = port
    link.send(port, b"START\n")
    assert not port.is_open


def test_a_chunk_beyond_the_queue_is_dropped_and_counted() -> None:
    counters = Counters(link=LinkCounters())
    queue = Queue(1000, counters)
    chunk = Chunk(b"x" * 300, 0.0, _now())
    queue.put(chunk)  # 200 bytes are counted on top of each
    queue.put(chunk)
    queue.put(Chunk(b"y", 0.0, _now()))
    assert counters.queue_overflow_bytes == 1
    queue.put(WakeUp())  # what is no bytes has always room
    assert [type(queue.get(0.0)) for _ in range(4)] == [Chunk, Chunk, WakeUp, type(None)]
    queue.put(chunk)
    assert queue.get(0.0) is chunk
    assert counters.queue_overflow_bytes == 1
