"""``pfwd log`` with a simulated instrument: signals, losses, setups, refusals, what is loaded."""

import logging as logging_of_python
import signal
import socket
import subprocess
import sys
import textwrap
import time
import unicodedata
from pathlib import Path

import numpy as np
import pytest

from pfwd_device import Drop
from pfwd_device.recording import DropRecord, SurveyWriter
from simulators.instrument import serve
from tests.tui.console import (
    CHANNELS,
    PATIENCE,
    PLAIN,
    RATE,
    TOP,
    WITH_SHUNT,
    checked,
    numbers,
    pfwd,
    records,
    running,
    wait_for_line,
)
from tui.log_file import survey_log


def test_a_survey_and_a_point_are_continued(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    seen = []
    for seed, options in ((1, ("--point", "A")), (2, ()), (3, ("--point", "B"))):
        with serve(PLAIN, drops=1, rate=RATE, seed=seed) as instrument:
            done = pfwd("log", instrument.url, "-o", survey, "--json", "--no-invert", *options)
        assert done.returncode == 0, done.stderr
        seen += numbers(records(done.stdout))
    assert seen == [("A", 1), ("A", 2), ("B", 1)]
    assert checked(survey)["drops_acknowledged"] == 3


def test_another_calibration_is_wrong_usage_until_it_is_accepted(tmp_path: Path) -> None:
    survey, setup = tmp_path / "survey", tmp_path / "setup.toml"
    setup.write_text('[[channels]]\nname = "centre"\nsensitivity = -57.6\n', "utf-8")
    statuses = []
    for options in ((), ("--setup", setup), ("--setup", setup, "--accept-calibration")):
        # Not on a pseudo-terminal, see below.
        listen = "tcp://127.0.0.1:0"
        with serve(PLAIN, drops=1, listen=listen, rate=RATE, seed=len(options)) as instrument:
            done = pfwd("log", instrument.url, "-o", survey, "--json", "--no-invert", *options)
        statuses.append((done.returncode, len(records(done.stdout))))
        if options:
            assert "sensitivity of centre is -57.6 V per m/s, was " in done.stderr
    assert statuses == [(0, 1), (2, 0), (0, 1)], done.stderr


@pytest.mark.posix
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_it_cleanly(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    # A process inherits that a signal is ignored, as by nohup.
    before = signal.signal(signal.Signals[name], signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.Signals[name], before))
    survey = tmp_path / "survey"
    with (
        serve(PLAIN, rate=RATE, seed=4) as instrument,
        running("log", instrument.url, "-o", survey, "--json", "--no-invert") as process,
    ):
        lines = [wait_for_line(process), wait_for_line(process)]
        # Somebody else is refused meanwhile, in one line that names the first.
        second = pfwd("log", instrument.url, "-o", survey, "--json", "--no-invert")
        assert second.returncode == 1
        assert second.stdout == ""
        assert f"pid {process.pid}" in second.stderr
        assert second.stderr.count("\n") == 1
        process.send_signal(signal.Signals[name])
        out, err = process.communicate(timeout=PATIENCE)
        lines += records(out)
        assert process.returncode == 0, err
    assert [line["drop"] for line in lines] == list(range(1, len(lines) + 1))
    record = checked(survey)
    assert record["ok"]
    assert record["drops_acknowledged"] == record["drops_published"] == len(lines)


def test_a_lost_instrument_is_status_3(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    # Not on a pseudo-terminal: its name may be another test's as soon as it is closed, and the
    # program that looks for its instrument there would take that one.
    instrument = serve(PLAIN, listen="tcp://127.0.0.1:0", rate=RATE, seed=5)
    options = ("--json", "--no-invert", "--give-up", "0.5")
    with instrument, running("log", instrument.url, "-o", survey, *options) as process:
        wait_for_line(process)
        instrument.close()
        _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 3, err
        assert "INSTRUMENT LOST" in err
    assert checked(survey)["ok"]


LINES = """
plate_radius_m = 0.15
plate_mass_kg = 10.6
[link]
dialect = "ascii"
sampling_rate_hz = 10000.0
[instrument]
adc_bits = 18
adc_range_v = 5.0
[[channels]]
name = "load"
column = 1
role = "load"
sensitivity = 4e-4
[[channels]]
name = "centre"
column = 2
role = "geophone"
sensitivity = 28.8
natural_frequency_hz = 4.5
damping = 0.6
"""


def test_an_instrument_that_only_prints_lines(tmp_path: Path) -> None:
    setup = tmp_path / "setup.toml"
    setup.write_text(LINES)
    options = ("-o", tmp_path / "survey", "--json", "--setup", setup, "--drops", 1, "--capture")
    with serve("ascii", rate=2.0, seed=6) as instrument:
        done = pfwd("log", instrument.url, *options)
    assert done.returncode == 0, done.stderr
    lines = records(done.stdout)
    assert [line["method"] for line in lines] == ["posterior", "mpga"]
    assert 2e7 < lines[0]["modulus_pa"] < 9e7
    (capture,) = (tmp_path / "survey" / "captures").glob("*.pfwdc")
    again = pfwd("replay", capture, "--json", "--no-invert", "-o", tmp_path / "survey")
    assert "not recorded twice" in again.stderr


def test_without_a_plate_radius_nothing_is_armed(tmp_path: Path) -> None:
    bare = {"base": "default", "device": {"channels": CHANNELS, "plate_declared": False}}
    with serve(bare, drops=1, rate=RATE) as instrument:
        done = pfwd("log", instrument.url, "-o", tmp_path / "s", "--json")
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.count("\n") == 1
        assert "Recording does not start: write plate_radius_m" in done.stderr
        setup = tmp_path / "setup.toml"
        setup.write_text("plate_radius_m = 0.15")
        options = ("--json", "--setup", setup, "--no-invert", "--drops", 1)
        again = pfwd("log", instrument.url, "-o", tmp_path / "s", *options)
        assert again.returncode == 0, again.stderr
        assert len(records(again.stdout)) == 1


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("log", "nowhere", "-o", "{}/s"), 3, "nowhere"),
        (("live", "nowhere", "-o", "{}/s", "--json"), 3, "nowhere"),
        (("log", "nowhere", "-o", "{}/s", "--setup", "{}/none.toml"), 1, "none.toml"),
        (("log", "nowhere", "-o", "{}/file"), 1, "file"),
        (("log", "nowhere", "-o", "{}/s", "--point", " "), 2, "--point"),
        (("log", "nowhere"), 2, "-o/--output"),
        (("log", "nowhere", "-o", "{}/s", "--drops", "0"), 2, "--drops"),
        (("log", "nowhere", "-o", "{}/s", "--give-up", "nan"), 2, "--give-up"),
        (("log", "nowhere", "-o", "{}/s", "--seed", "-1"), 2, "--seed"),
        (("replay", "{}/none"), 1, "expected a survey or a capture"),
        (("replay", "{}/file"), 1, "capture"),
        (("replay", "{}/s", "--speed", "-1"), 2, "--speed"),
        (("check", "{}/none"), 1, "no such folder"),
        (("recover", "{}"), 1, "another folder"),
        (("edit", "{}"), 1, "another folder"),
        (("import", "{}/none.csv", "-o", "{}/s"), 1, "none.csv"),
        (("import", "x.txt", "-o", "{}/s", "--map", "{}/none.toml"), 2, "--map"),
        (("export", "{}", "--format", "csv", "-o", "{}/out"), 1, "expected a survey"),
        (("report", "{}", "-o", "{}/r.pdf"), 1, "the folder of a survey"),
        (("report", "{}", "-o", "{}/r.pdf", "--language", "fr"), 2, "expected one of de, en, zh"),
        (("log", "/dev/none", "-o", "{}/s", "--gps", "/dev/no-receiver"), 3, "/dev/no-receiver"),
        (("demo", "--scenario", "unheard-of"), 2, "unheard-of"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    arguments: tuple[str, ...],
    status: int,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from tui.cli import main

    (tmp_path / "file").write_text("text")
    given = [part.replace("{}", str(tmp_path)) for part in arguments]
    try:
        found = main(given)
    except SystemExit as err:
        found = int(str(err.code))
    output = capsys.readouterr()
    assert found == status, output.err
    assert output.out == ""
    assert message in output.err.splitlines()[-1]
    assert "Traceback" not in output.err
    assert "unexpected error" not in output.err


@pytest.mark.parametrize("more", [(), ("--capture",), ("--no-invert",)])
@pytest.mark.parametrize("command", ["log", "live"])
def test_a_port_that_is_not_there_leaves_nothing_behind(
    command: str, more: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from tui.cli import main

    port = str(tmp_path / "ttyUSB9")
    options = ("--json",) if command == "live" else more
    assert main([command, port, "-o", str(tmp_path / "s"), *options]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{port}: not found." in line
    assert line.endswith("Check the cable or choose another port")
    assert list(tmp_path.iterdir()) == []


def test_a_port_that_another_program_uses_is_said_and_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The server accepts no second host, as of an instrument that another program reads."""
    from tui.cli import main

    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        assert main(["log", url, "-o", str(tmp_path / "s"), "--give-up", "0.3"]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{url}: no instrument for 0.3 s (--give-up)" in line
    assert "End other programs that use the port" in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("sensitivity", [1e300, -1e300, 1e-300])
def test_a_sensitivity_that_measures_nothing_is_refused(sensitivity: float, tmp_path: Path) -> None:
    channels = [CHANNELS[0], {**CHANNELS[1], "sensitivity": sensitivity}]
    with serve({"base": "default", "device": {"channels": channels}}, drops=1) as instrument:
        done = pfwd("log", instrument.url, "-o", tmp_path / "s", "--drops", 1)
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert "channel 'centre': sensitivity: expected one with a full scale from" in line
    assert f"got {sensitivity:g} V per m/s" in line
    assert "Recording does not start" in line


def test_the_log_waits_for_the_folder_of_the_survey(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with survey_log(survey):
        logging_of_python.getLogger("pfwd").warning("before")
        assert not survey.exists()
        survey.mkdir()
        logging_of_python.getLogger("pfwd").warning("after")
    lines = (survey / "log" / "pfwd.log").read_text(encoding="utf-8").splitlines()
    assert [line.rpartition(": ")[2] for line in lines] == ["before", "after"]


def test_the_log_file_is_bounded_and_harmless(tmp_path: Path) -> None:
    with serve("hostile", drops=1, rate=WITH_SHUNT) as instrument:
        done = pfwd("log", instrument.url, "-o", tmp_path / "s", "--no-invert")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "s" / "log" / "pfwd.log").read_text(encoding="utf-8")
    assert "saved as 1" in text
    for shown in (text, done.stdout, done.stderr):
        bad = [letter for letter in shown if unicodedata.category(letter)[0] == "C"]
        assert set(bad) <= {"\n"}


def modules_after(code: str) -> set[str]:
    script = f"import sys\n{textwrap.dedent(code)}\nprint(*sys.modules, sep='\\n', file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=TOP, capture_output=True, text=True, timeout=PATIENCE
    )
    return {name.split(".")[0] for name in done.stderr.splitlines()}


RECORDS_OF_RESULTS = {"inversion.errors", "inversion.records", "inversion.result"}


def test_logging_alone_loads_neither_solvers_nor_hdf5(tmp_path: Path) -> None:
    with serve(PLAIN, drops=1, rate=RATE, seed=8) as instrument:
        code = f"""
            from tui.cli import main
            main(["log", {instrument.url!r}, "-o", {str(tmp_path / "s")!r}, "--no-invert"])
        """
        loaded = modules_after(code)
    assert "numpy" in loaded
    assert not loaded & {"scipy", "h5py", "textual", "matplotlib", "rich"}
    # Records of results, which are shown without what computes them.
    assert {name for name in loaded if name.startswith("inversion.")} <= RECORDS_OF_RESULTS


def test_a_list_of_points_loads_nothing_that_only_others_need(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        writer.save_drop(DropRecord("P", Drop(1, np.arange(4.0), np.zeros(4), ())))
    code = f"""
        from tui.cli import main
        main(["edit", {str(tmp_path / "s")!r}])
    """
    loaded = modules_after(code)
    assert "numpy" in loaded
    assert not loaded & {"h5py", "csv", "multiprocessing", "concurrent"}


@pytest.mark.posix
def test_a_service_is_stopped_within_its_time(tmp_path: Path) -> None:
    """With inversion: the last analyses are waited for, and nothing is left behind."""
    with (
        serve(PLAIN, rate=RATE, seed=9) as instrument,
        running("log", instrument.url, "-o", tmp_path / "s", "--json") as process,
    ):
        wait_for_line(process)
        begin = time.monotonic()
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, err
        assert time.monotonic() - begin < 30
    acknowledged = checked(tmp_path / "s")["drops_acknowledged"]
    assert {line["drop"] for line in records(out)} | {1} == set(range(1, acknowledged + 1))
