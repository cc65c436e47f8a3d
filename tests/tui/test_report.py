"""``pfwd report`` after a measurement with a procedure and positions, and ``pfwd procedures``."""

import contextlib
import socket
import threading
from pathlib import Path

import pytest

from pfwd_device.recording import read_survey
from simulators.instrument import serve
from tests.tui.console import PATIENCE, PLAIN, RATE, logged, pfwd, records
from tui.cli import main

# The example that most descriptions of NMEA print.
NMEA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"


def test_a_survey_with_positions_and_a_procedure_is_reported(tmp_path: Path) -> None:
    listening = socket.create_server(("127.0.0.1", 0))
    listening.settimeout(PATIENCE)
    finished = threading.Event()

    def receiver() -> None:
        # The command may close the link a moment before `finished` is set.
        with listening.accept()[0] as link, contextlib.suppress(OSError):
            while not finished.wait(0.1):
                link.sendall(b"noise\xff\n" + NMEA)

    thread = threading.Thread(target=receiver, daemon=True)
    thread.start()
    options = ("--gps", f"socket://127.0.0.1:{listening.getsockname()[1]}", "--drops", 6)
    survey = tmp_path / "s"
    try:
        with serve(PLAIN, drops=6, rate=RATE, seed=1) as instrument:
            procedure = ("--procedure", "tp-bf-stb-b8.3")
            *drops, point = logged(instrument, survey, "--no-invert", *options, *procedure)
    finally:
        finished.set()
        thread.join(PATIENCE)
        listening.close()
    assert point["complete"] is True
    assert [line["status"] for line in drops] == ["seating"] * 3 + ["measured"] * 3
    position = read_survey(survey).drops[0].read().metadata["position"]
    assert (round(position["latitude"], 4), round(position["longitude"], 4)) == (48.1173, 11.5167)
    assert position["hdop"] == 0.9
    html, pdf = tmp_path / "r.html", tmp_path / "r.pdf"
    (point,) = records(pfwd("report", survey, "-o", html, "--json", "--target", 30).out)
    assert (point["point"], point["used"], point["verdict"]) == ("1", [4, 5, 6], "undecided")
    assert point["verdict_reason_code"] == "precondition", "this instrument drops with 9.7 kN"
    assert (point["value"]["quantity"], point["target"]) == ("E_vd", 30e6)
    page = html.read_text(encoding="utf-8")
    assert "tp-bf-stb-b8.3" in page
    assert "48.117300, 11.516667, nmea" in page
    report = pfwd("report", survey, "-o", pdf, "--language", "de")
    assert report.out == "point 1: no verdict, there is no target\n", report.err
    assert pdf.read_bytes().startswith(b"%PDF")


def test_procedures_are_listed_with_their_sources(capsys: pytest.CaptureFixture[str]) -> None:
    def printed(*arguments: str) -> str:
        assert main(["procedures", *arguments]) == 0
        return capsys.readouterr().out

    table = {line["name"]: line for line in records(printed("--json"))}
    assert len(table) == 6
    german = table["tp-bf-stb-b8.3"]["numbers"]
    assert german["seating"]["value"] == 3
    assert german["seating"]["enforced"] is True
    assert german["shortest_pulse_s"]["enforced"] is False
    listed = printed().splitlines()
    assert len(listed) == 6
    assert listed[1].split()[:4] == ["astm-e2835", "(3)", "+", "(3)"]
    text = printed("mndot")
    assert "average of the fourth, fifth and sixth drops" in text
    assert "NOT VERIFIED, not enforced" in text
    assert main(["procedures", "none"]) == 2
