"""``pfwd report`` and ``pfwd procedures``: what is measured with a procedure is reported by it."""

import contextlib
import socket
import threading
from pathlib import Path

import pytest

from pfwd_device.recording import read_survey
from simulators.instrument import serve
from tests.tui.console import PATIENCE, PLAIN, RATE, pfwd, records
from tui.cli import main

# The example that most descriptions of NMEA print.
NMEA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"


def test_measured_by_a_procedure_and_reported(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with serve(PLAIN, drops=6, rate=RATE, seed=1) as instrument:
        done = pfwd(
            *("log", instrument.url, "-o", survey, "--procedure", "tp-bf-stb-b8.3"),
            *("--json", "--drops", 6),
        )
    assert done.returncode == 0, done.stderr
    *drops, point = records(done.stdout)
    assert point["complete"] is True
    status = {line["drop"]: line["status"] for line in drops}
    assert list(status.values()) == ["seating"] * 3 + ["measured"] * 3
    done = pfwd("report", survey, "-o", tmp_path / "r.html", "--json", "--target", 30)
    assert done.returncode == 0, done.stderr
    (point,) = records(done.stdout)
    assert (point["point"], point["used"], point["verdict"]) == ("1", [4, 5, 6], "undecided")
    assert point["verdict_reason_code"] == "precondition", "this instrument drops with 9.7 kN"
    assert "this procedure needs 7.07 kN" in point["verdict_reason"]
    assert point["value"]["quantity"] == "E_vd"
    assert point["target"] == 30e6
    assert "tp-bf-stb-b8.3" in (tmp_path / "r.html").read_text(encoding="utf-8")
    done = pfwd("report", survey, "-o", tmp_path / "r.pdf", "--language", "de")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "point 1: no verdict, there is no target\n"
    assert (tmp_path / "r.pdf").read_bytes().startswith(b"%PDF")


def test_every_drop_keeps_its_position(tmp_path: Path) -> None:
    listening = socket.create_server(("127.0.0.1", 0))
    listening.settimeout(PATIENCE)
    over = threading.Event()

    def receiver() -> None:
        # The command leaves when it has what it wants, a moment before `over` is set.
        with listening.accept()[0] as link, contextlib.suppress(OSError):
            while not over.wait(0.1):
                link.sendall(b"noise\xff\n" + NMEA)

    thread = threading.Thread(target=receiver, daemon=True)
    thread.start()
    url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
    try:
        with serve(PLAIN, drops=1, rate=RATE, seed=1) as instrument:
            done = pfwd(
                *("log", instrument.url, "-o", tmp_path / "s", "--gps", url),
                *("--drops", 1, "--no-invert"),
            )
    finally:
        over.set()
        thread.join(PATIENCE)
        listening.close()
    assert done.returncode == 0, done.stderr
    assert "no position" not in done.stderr
    said = read_survey(tmp_path / "s").drops[0].read().metadata["position"]
    assert (round(said["latitude"], 4), round(said["longitude"], 4)) == (48.1173, 11.5167)
    assert said["hdop"] == 0.9
    done = pfwd("report", tmp_path / "s", "-o", tmp_path / "r.html")
    assert done.returncode == 0, done.stderr
    assert "48.117300, 11.516667, nmea" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_procedures_are_listed_with_their_sources(capsys: pytest.CaptureFixture[str]) -> None:
    def shown(*arguments: str) -> str:
        assert main(["procedures", *arguments]) == 0
        return capsys.readouterr().out

    table = {line["name"]: line for line in records(shown("--json"))}
    assert len(table) == 6
    german = table["tp-bf-stb-b8.3"]["numbers"]
    assert german["seating"]["value"] == 3
    assert german["seating"]["enforced"] is True
    assert german["shortest_pulse_s"]["enforced"] is False
    listed = shown().splitlines()
    assert len(listed) == 6
    assert listed[1].split()[:4] == ["astm-e2835", "(3)", "+", "(3)"]
    one = shown("mndot")
    assert "average of the fourth, fifth and sixth drops" in one
    assert "NOT VERIFIED, not enforced" in one
    assert main(["procedures", "none"]) == 2
