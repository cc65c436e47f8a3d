"""``pfwd report`` and ``pfwd procedures``: what is measured with a procedure is reported by it."""

import contextlib
import socket
import threading
from pathlib import Path

from pfwd_device.recording import read_survey
from simulators.instrument import serve
from tests.tui.console import PATIENCE, PLAIN, RATE, pfwd, records

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
    done = pfwd(
        *("report", survey, "-o", tmp_path / "slip.pdf", "--point", "1", "--slip"),
        *("--signed", "Jo"),
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "slip.pdf").read_bytes().startswith(b"%PDF")


def test_wrong_usage_has_status_2(tmp_path: Path) -> None:
    done = pfwd("report", tmp_path, "-o", tmp_path / "r.doc")
    assert done.returncode == 2
    assert "ending in .html or .pdf" in done.stderr
    done = pfwd("report", tmp_path, "-o", tmp_path / "r.pdf", "--language", "fr")
    assert done.returncode == 2
    assert "expected one of de, en, zh" in done.stderr


def test_data_that_is_no_survey_has_status_1(tmp_path: Path) -> None:
    done = pfwd("report", tmp_path, "-o", tmp_path / "r.pdf")
    assert done.returncode == 1
    assert "the folder of a survey" in done.stderr


def test_a_receiver_that_is_not_there_is_told(tmp_path: Path) -> None:
    done = pfwd("log", "/dev/none", "-o", tmp_path / "s", "--gps", "/dev/no-receiver")
    assert done.returncode == 3
    assert "/dev/no-receiver" in done.stderr


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


def test_procedures_are_listed_with_their_sources() -> None:
    done = pfwd("procedures", "--json")
    assert done.returncode == 0, done.stderr
    table = {line["name"]: line for line in records(done.stdout)}
    assert len(table) == 6
    german = table["tp-bf-stb-b8.3"]["numbers"]
    assert german["seating"]["value"] == 3
    assert german["seating"]["enforced"] is True
    assert german["shortest_pulse_s"]["enforced"] is False
    listed = pfwd("procedures").stdout.splitlines()
    assert len(listed) == 6
    assert listed[1].split()[:4] == ["astm-e2835", "(3)", "+", "(3)"]
    one = pfwd("procedures", "mndot").stdout
    assert "average of the fourth, fifth and sixth drops" in one
    assert "NOT VERIFIED, not enforced" in one
    assert pfwd("procedures", "none").returncode == 2


def test_a_survey_in_one_file_is_reported_with_a_target(tmp_path: Path) -> None:
    with serve(PLAIN, drops=1, rate=RATE, seed=1) as instrument:
        done = pfwd("log", instrument.url, "-o", tmp_path / "s", "--drops", 1, "--no-invert")
    assert done.returncode == 0, done.stderr
    file = tmp_path / "s.pfwdz"
    done = pfwd("export", tmp_path / "s", "--format", "pfwdz", "-o", file)
    assert done.returncode == 0, done.stderr
    done = pfwd("report", file, "-o", tmp_path / "r.html", "--target", 45)
    assert done.returncode == 0, done.stderr
    assert "s.pfwdz --target 45" in done.stderr
