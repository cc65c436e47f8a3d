"""Positions from a satellite receiver: garbage, no fix, staleness, a receiver that is lost."""

import time
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd.session.position import NmeaParser, PositionReceiver
from pfwd_device.errors import DeviceError, DeviceLost

PATIENCE = 60.0  # s


def sentence(body: str) -> bytes:
    """NMEA 0183: the checksum is the exclusive or of everything between $ and *."""
    total = 0
    for letter in body.encode():
        total ^= letter
    return f"${body}*{total:02X}\r\n".encode()


# 48 deg 07.038' N, 11 deg 31.000' E: the example that most descriptions of NMEA print, with its
# checksum 47.
EXAMPLE = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
SOUTH_WEST = sentence("GNGGA,101112.00,3351.650,S,07040.200,W,4,14,0.6,570.1,M,26.0,M,1.0,0001")
NO_FIX = sentence("GPGGA,123519,,,,,0,00,99.9,,M,,M,,")


def test_the_helper_computes_the_published_checksum() -> None:
    assert sentence(EXAMPLE[1:-5].decode()) == EXAMPLE


def test_a_position_has_its_quality_and_is_negative_in_south_and_west() -> None:
    fix, other = NmeaParser(lambda: 7.0).feed(EXAMPLE + SOUTH_WEST)
    assert fix.latitude == pytest.approx(48 + 7.038 / 60)
    assert fix.longitude == pytest.approx(11 + 31.0 / 60)
    assert (fix.quality, fix.satellites, fix.hdop, fix.altitude) == (1, 8, 0.9, 545.4)
    assert fix.time_utc == "12:35:19+00:00"
    assert fix.received == 7.0
    assert other.latitude == pytest.approx(-(33 + 51.65 / 60))
    assert other.longitude == pytest.approx(-(70 + 40.2 / 60))
    assert other.quality == 4


# Some receivers go on naming the last place when they have lost the satellites.
LOST_FIX = sentence("GPGGA,123519,4807.038,N,01131.000,E,0,00,99.9,545.4,M,46.9,M,,")


@pytest.mark.parametrize("without", [NO_FIX, LOST_FIX])
def test_no_fix_is_no_position(without: bytes) -> None:
    parser = NmeaParser()
    assert parser.feed(without) == []
    assert (parser.without_fix, parser.refused) == (1, 0)


@pytest.mark.parametrize(
    "damaged",
    [
        EXAMPLE.replace(b"4807", b"4907"),  # a flipped digit is a place a degree away
        EXAMPLE.replace(b"*47", b""),  # nothing to check it by
        EXAMPLE.replace(b"*47", b"*zz"),
        sentence("GPGGA,123519,9907.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"),
        sentence("GPGGA,123519,4807.038,N,01131.000,E,x,08,0.9,545.4,M,46.9,M,,"),
        sentence("GPGGA"),
        b"\xff\x00 noise without a sentence\n",
    ],
)
def test_a_damaged_sentence_is_counted_and_the_next_is_read(damaged: bytes) -> None:
    parser = NmeaParser()
    fixes = parser.feed(damaged + EXAMPLE)
    assert [fix.altitude for fix in fixes] == [545.4]
    assert parser.refused == 1
    assert len(NmeaParser().feed(b"\x80\x80$GPGS" + EXAMPLE)) == 1


def test_a_line_without_end_does_not_grow() -> None:
    parser = NmeaParser()
    for _ in range(100):
        parser.feed(b"x" * 500)
    assert parser.refused
    assert len(parser.feed(b"\n" + EXAMPLE)) == 1


@given(st.lists(st.integers(0, 300), max_size=12))
def test_it_does_not_matter_how_the_bytes_were_cut(places: list[int]) -> None:
    data = EXAMPLE + b"junk\n" + SOUTH_WEST + NO_FIX + EXAMPLE
    parser, fixes = NmeaParser(lambda: 0.0), []
    ends = sorted({min(place, len(data)) for place in places} | {len(data)})
    for start, end in zip([0, *ends], ends, strict=False):
        fixes += parser.feed(data[start:end])
    assert fixes == NmeaParser(lambda: 0.0).feed(data)
    assert len(fixes) == 3


@given(st.binary(max_size=200))
def test_no_bytes_are_an_unforeseen_error(data: bytes) -> None:
    NmeaParser().feed(data + b"\n$" + data + b"\n")


class Port:
    """A port that gives what is written out here, then silence, then is lost if told so."""

    url = description = "scripted"

    def __init__(self, *pieces: bytes, lost: bool = False) -> None:
        self._pieces = list(pieces)
        self._lost = lost
        self.closed = False

    def read(self, timeout: float) -> bytes:
        if self._pieces:
            return self._pieces.pop(0)
        if self._lost:
            raise DeviceLost("scripted: unplugged")
        time.sleep(0.01)
        return b""

    def write(self, data: bytes) -> None:
        raise AssertionError("nothing is sent to a receiver")

    def close(self) -> None:
        self.closed = True


def until(holds: Callable[[], Any]) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.01)


def test_a_drop_gets_the_position_with_its_age() -> None:
    now = [100.0]
    port = Port(EXAMPLE)
    receiver = PositionReceiver("x", open_port=lambda: port, clock=lambda: now[0])
    assert "nothing received" in receiver.record()["fault"]
    with receiver:
        until(receiver.latest)
        now[0] = 103.0
        position = receiver.record()
        assert position["latitude"] == pytest.approx(48.1173)
        facts = {"hdop": 0.9, "fix_quality": 1, "fix": "satellites", "age_s": 3.0}
        assert facts.items() <= position.items()
        assert receiver.warning() is None
        now[0] = 120.0
        stale = receiver.record()
        assert "latitude" not in stale, "an old position is not where the drop fell"
        assert stale["last_known"]["latitude"] == pytest.approx(48.1173)
        assert "stale: 20 s" in stale["fault"]
        assert "stale" in (receiver.warning() or "")
    assert port.closed


def test_a_poor_position_has_a_warning() -> None:
    poor = sentence("GPGGA,123519,4807.038,N,01131.000,E,1,03,9.5,545.4,M,46.9,M,,")
    with PositionReceiver("x", open_port=lambda: Port(poor)) as receiver:
        until(receiver.latest)
        assert receiver.warning() == "poor position: HDOP 9.5"


def test_a_receiver_that_is_lost_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pfwd.session.position.RECONNECT_INTERVAL", 0.01)
    ports = iter([Port(lost=True), Port(EXAMPLE)])
    with PositionReceiver("x", open_port=lambda: next(ports)) as receiver:
        until(receiver.latest)


def test_a_port_that_cannot_be_opened_is_an_error() -> None:
    with pytest.raises(DeviceError, match="no-such-port"):
        PositionReceiver("/dev/no-such-port").open()
