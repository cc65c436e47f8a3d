"""``pfwd log`` with a simulated instrument: signals, losses, setups, refusals, imported modules."""

import signal
import socket
import subprocess
import sys
import textwrap
import time
import unicodedata
from pathlib import Path

import pytest

from simulators.instrument import serve
from tests.tui.console import (
    CHANNELS,
    PATIENCE,
    PLAIN,
    RATE,
    TOP,
    WITH_SHUNT,
    checked,
    logged,
    numbers,
    pfwd,
    records,
    running,
    wait_for_line,
)
from tests.tui.surveys import write_small_survey

# A pseudo-terminal that is closed may have its name given to that of another test, whose
# instrument a program that reconnects would take.
TCP = "tcp://127.0.0.1:0"


def test_a_survey_is_continued_unless_the_calibration_changed(tmp_path: Path) -> None:
    survey, setup = tmp_path / "survey", tmp_path / "setup.toml"
    setup.write_text('[[channels]]\nname = "centre"\nsensitivity = -57.6\n', "utf-8")
    drops = []
    for seed, options in ((1, ("--point", "A")), (2, ())):
        with serve(PLAIN, drops=1, rate=RATE, seed=seed) as instrument:
            drops += numbers(logged(instrument, survey, "--no-invert", *options))
    command = ("-o", survey, "--json", "--no-invert", "--setup", setup)
    for seed, options, status in ((3, (), 2), (4, ("--accept-calibration", "--point", "B"), 0)):
        with serve(PLAIN, drops=1, listen=TCP, rate=RATE, seed=seed) as instrument:
            completed = pfwd("log", instrument.url, *command, *options)
        assert completed.status == status, completed.err
        drops += numbers(records(completed.out))
        assert "sensitivity of centre is -57.6 V per m/s, was " in completed.err
    assert drops == [("A", 1), ("A", 2), ("B", 1)]
    assert checked(survey)["drops_acknowledged"] == 3


@pytest.mark.posix
@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP"])
def test_a_signal_ends_logging(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    # A process inherits that a signal is ignored, as by nohup.
    before = signal.signal(signal.Signals[name], signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.Signals[name], before))
    survey = tmp_path / "survey"
    with (
        serve(PLAIN, rate=RATE, seed=4) as instrument,
        running("log", instrument.url, "-o", survey, "--json", "--no-invert") as process,
    ):
        lines = [wait_for_line(process), wait_for_line(process)]
        if name == "SIGINT":  # a second program is refused in one line that names the first
            second = pfwd("log", instrument.url, "-o", survey, "--json", "--no-invert")
            assert (second.status, second.out) == (1, "")
            assert f"pid {process.pid}" in second.err
            assert second.err.count("\n") == 1
        process.send_signal(signal.Signals[name])
        out, err = process.communicate(timeout=PATIENCE)
        lines += records(out)
        assert process.returncode == 0, err
    assert [line["drop"] for line in lines] == list(range(1, len(lines) + 1))
    record = checked(survey)
    assert record["ok"]
    assert record["drops_acknowledged"] == record["drops_published"] == len(lines)


@pytest.mark.posix
def test_a_service_that_inverts_is_stopped_within_its_time(tmp_path: Path) -> None:
    """The last analyses are awaited, and every acknowledged drop has its line."""
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


def test_a_lost_instrument_is_status_3(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    instrument = serve(PLAIN, listen=TCP, rate=RATE, seed=5)
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
    setup, survey = tmp_path / "setup.toml", tmp_path / "survey"
    setup.write_text(LINES)
    with serve("ascii", rate=2.0, seed=6) as instrument:
        lines = logged(instrument, survey, "--setup", setup, "--drops", 1, "--capture")
    assert [line["method"] for line in lines] == ["posterior", "mpga"]
    assert 2e7 < lines[0]["modulus_pa"] < 9e7
    (capture,) = (survey / "captures").glob("*.pfwdc")
    replay = pfwd("replay", capture, "--json", "--no-invert", "-o", survey)
    assert "not recorded twice" in replay.err


def test_recording_requires_a_plate_radius_and_sensible_sensitivities(tmp_path: Path) -> None:
    bare = {"base": "default", "device": {"channels": CHANNELS, "plate_declared": False}}
    setup = tmp_path / "setup.toml"
    with serve(bare, drops=1, rate=RATE) as instrument:
        command = ("log", instrument.url, "-o", tmp_path / "s", "--no-invert", "--drops", 1)
        for text, message in (
            ("", "write plate_radius_m"),
            (
                'plate_radius_m = 0.15\n[[channels]]\nname = "centre"\nsensitivity = 1e300',
                "sensitivity: expected one with a full scale from",
            ),
        ):
            setup.write_text(text)
            completed = pfwd(*command, "--setup", setup)
            assert (completed.status, completed.out) == (1, "")
            (line,) = completed.err.splitlines()
            assert "Recording does not start" in line
            assert message in line
        setup.write_text("plate_radius_m = 0.15")
        assert len(logged(instrument, *command[3:], "--setup", setup)) == 1


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("log", "nowhere", "-o", "{}/s"), 3, "nowhere"),
        (("live", "/dev/x", "-o", "{}/s"), 2, "expected a terminal"),
        (("replay", "{}/s", "--live"), 2, "expected a terminal"),
        (("log", "nowhere", "-o", "{}/s", "--setup", "{}/none.toml"), 1, "none.toml"),
        (("log", "nowhere", "-o", "{}/s", "--point", " "), 2, "--point"),
        (("log", "nowhere"), 2, "-o/--output"),
        (("log", "nowhere", "-o", "{}/s", "--drops", "0"), 2, "--drops"),
        (("log", "nowhere", "-o", "{}/s", "--give-up", "nan"), 2, "--give-up"),
        (("log", "nowhere", "-o", "{}/s", "--seed", "-1"), 2, "--seed"),
        (("log", "/dev/none", "-o", "{}/s", "--gps", "/dev/no-receiver"), 3, "/dev/no-receiver"),
        (("log", "nowhere", "-o", "{}/file"), 1, "expected a folder that can be written"),
        (("live", "nowhere", "-o", "{}/file/s"), 1, "expected a folder that can be written"),
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
        (("demo", "--scenario", "unheard-of"), 2, "unheard-of"),
        (("simulate", "--scenario", "unheard-of"), 2, "expected an existing file or one of ascii"),
        (("simulate", "--listen", "morse"), 2, "expected pty or tcp://HOST:PORT"),
        (("simulate", "--drops", "0"), 2, "from 1"),
        (("simulate", "--rate", "-1"), 2, "--rate"),
        (("conform", "socket://127.0.0.1:9"), 3, "127.0.0.1:9"),
        (("conform", "x", "--only", "P-99"), 2, "expected numbers from P-1 to P-42, got P-99"),
        (("lvie", "x"), 2, "'lvie' is not a command; did you mean live?"),
        (("qqq",), 2, "'qqq' is not a command; pfwd help --all"),
        (("log", "x", "-o", "y", "--procedur", "mndot"), 2, "did you mean --procedure?"),
        (("log", "x", "-o", "y", "--targett=4"), 2, "did you mean --target?"),
        (("edit", "x", "--zzz"), 2, "unrecognized arguments: --zzz"),
        (("invert", "x", "--plate", "rigid-rouhg"), 2, "did you mean rigid-rough?"),
        # The missing input would be refused with 1: an output is refused before the work.
        (("invert", "x", "--plot", "{}/none/p.png"), 2, "expected the folder"),
        (("diagnose", "x", "--plot", "{}/none/p.png"), 2, "expected the folder"),
        (("diagnose", "x", "--write-device", "{}/none/d.toml"), 2, "expected the folder"),
        (("report", "x", "-o", "{}/none/r.pdf"), 2, "expected the folder"),
        (("export", "x", "--format", "csv", "-o", "{}/none/folder"), 2, "expected the folder"),
        (("invert",), 2, "FILE"),
        (("invert", "x", "--model", "sand"), 2, "--model"),
        (("invert", "x", "--bedrock-depth", "deep"), 2, "--bedrock-depth"),
        (("invert", "x", "--jobs", "0"), 2, "--jobs"),
        (("invert", "x", "--plot", "a.xyz"), 2, "--plot"),
        (("invert", "x", "--publ"), 2, "--publ"),
        (("invert", "x", "--model", "half-space", "--bedrock-depth", "1"), 2, "one of the two"),
        (("invert", "x", "--published", "--plate", "rigid-rough"), 2, "--plate rigid-rough"),
        (("invert", "x", "--poisson-ratio", "0.5"), 2, "--poisson-ratio"),
        (("invert", "x", "--header", "none.toml"), 2, "none.toml: expected a TOML file"),
    ],
)
def test_a_refused_command_has_a_single_line_of_error(
    arguments: tuple[str, ...], status: int, message: str, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("text")
    printed = pfwd(*(part.replace("{}", str(tmp_path)) for part in arguments))
    assert (printed.status, printed.out) == (status, ""), printed.err
    assert message in printed.err.splitlines()[-1]
    assert "Traceback" not in printed.err
    assert "unexpected error" not in printed.err


@pytest.mark.parametrize(
    ("name", "option"), [("log", "--capture"), ("log", "--no-invert"), ("live", "--json")]
)
def test_a_missing_port_creates_no_file(name: str, option: str, tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB9"
    line = pfwd(name, port, "-o", tmp_path / "s", option).refusal
    assert f"{port}: not found." in line
    assert line.endswith("Check the cable or choose another port")
    assert list(tmp_path.iterdir()) == []


def test_a_port_in_use_is_reported_and_creates_no_file(tmp_path: Path) -> None:
    """The server accepts no second host, as of an instrument that another program reads."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        printed = pfwd("log", url, "-o", tmp_path / "s", "--give-up", "0.3")
    assert printed.status == 3
    assert f"{url}: no instrument for 0.3 s (--give-up)" in printed.refusal
    assert "End other programs that use the port" in printed.refusal
    assert list(tmp_path.iterdir()) == []


def test_the_log_file_of_a_hostile_instrument_is_harmless(tmp_path: Path) -> None:
    with serve("hostile", drops=1, rate=WITH_SHUNT) as instrument:
        completed = pfwd("log", instrument.url, "-o", tmp_path / "s", "--no-invert")
    assert completed.status == 0, completed.err
    text = (tmp_path / "s" / "log" / "pfwd.log").read_text(encoding="utf-8")
    assert "saved as 1" in text
    for output in (text, completed.out, completed.err):
        bad = [letter for letter in output if unicodedata.category(letter)[0] == "C"]
        assert set(bad) <= {"\n"}


def modules_after(command: list[str]) -> set[str]:
    """Return the modules that a command imports."""
    script = f"""
        import sys
        from tui.cli import main
        main({command!r})
        print(*sys.modules, sep="\\n", file=sys.stderr)
    """
    completed = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        cwd=TOP,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    return set(completed.stderr.splitlines())


def test_commands_import_only_the_modules_they_need(tmp_path: Path) -> None:
    with serve(PLAIN, drops=1, rate=RATE, seed=8) as instrument:
        modules = modules_after(["log", instrument.url, "-o", str(tmp_path / "s"), "--no-invert"])
    assert "numpy" in modules
    assert not modules & {"scipy", "h5py", "textual", "matplotlib", "rich"}
    modules = modules_after(["edit", str(write_small_survey(tmp_path / "points", "P"))])
    assert "numpy" in modules
    assert not modules & {"h5py", "csv", "multiprocessing", "concurrent"}
