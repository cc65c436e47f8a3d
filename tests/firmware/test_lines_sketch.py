"""The sketch of docs/build-an-instrument.md, compiled as it stands, against the decoder."""

import datetime
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pfwd.session.setup_file import parse_setup
from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.detection import RawDrop
from pfwd_device.acquisition.detector import DetectedItem, Detector
from pfwd_device.acquisition.items import Connected, Gap, Samples
from simulators.firmware import Played, play_scenario, zig_command

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "build-an-instrument.md"
MAX_LINES = 40
STUB = """
#include <cstdint>
#include <cstdio>
#include <cstdlib>
static uint32_t now;
static size_t played;
static int32_t samples[][2] = {
#include "samples.inc"
};
static const size_t count = sizeof samples / sizeof samples[0];
uint32_t micros() { return now; }
struct Port {
    void begin(long) {}
    void print(uint32_t value) { std::printf("%lu", (unsigned long)value); }
    void print(int32_t value) { std::printf("%ld", (long)value); }
    void print(char value) { std::putchar(value); }
    void println(int32_t value) { std::printf("%ld\\r\\n", (long)value); now += 1700; }
} Serial;
void beginConverter() {}
static size_t place() { size_t at = now / 500; return at < count ? at : count - 1; }
int32_t readLoad() { return samples[place()][0]; }
int32_t readCentre() { return samples[place()][1]; }
"""
END = """
int main() { setup(); while (now / 500 < count) { loop(); now += 100; } }
"""


def blocks() -> dict[str, str]:
    text = DOCUMENT.read_text(encoding="utf-8")
    return dict(re.findall(r"```(cpp|toml)\n(.*?)```", text, re.DOTALL))


@pytest.fixture(scope="module")
def played() -> Played:
    device: dict[str, object] = {
        "sampling_rate": 2000.0,
        "sampling_rates": [2000.0],
        "adc_bits": 24,
    }
    drops = {"first": 2.0, "interval": 6.0, "quiet": 1.0, "bounces": [0, 0]}
    load = {"name": "load", "role": "load", "sensitivity": 1e-4, "noise": 4.0}
    centre = {"name": "centre", "sensitivity": 28.8, "noise": 4e-5}
    device |= {"adc_bits": 24, "adc_range": 2.5, "channels": [load, centre]}
    return play_scenario({"device": device, "drops": drops}, drops=2)


def test_the_sketch_has_at_most_forty_lines() -> None:
    assert len(blocks()["cpp"].splitlines()) <= MAX_LINES


def test_printed_drops_are_detected_with_the_printed_samples(
    tmp_path: Path, played: Played
) -> None:
    compiler = [shutil.which("c++") or shutil.which("g++")]
    command = [compiler[0]] if compiler[0] else zig_command("c++")
    if command is None:
        pytest.skip("needs a C++ compiler (c++, g++, or pip install ziglang)")
    rows = (f"{{{load},{centre}}}," for load, centre in played.counts.tolist())
    (tmp_path / "samples.inc").write_text("\n".join(rows), encoding="utf-8")
    source = tmp_path / "sketch.cpp"
    source.write_text(STUB + blocks()["cpp"] + END, encoding="utf-8")
    program = tmp_path / "sketch"
    subprocess.run([*command, "-O1", str(source), "-o", str(program)], check=True)
    output = subprocess.run([str(program)], check=True, capture_output=True).stdout
    assert len(output.splitlines()) == 2 * 1000

    setup = parse_setup(blocks()["toml"], "the page")
    decoder = Decoder(setup.device.make_dialect(1))
    now = datetime.datetime.now(datetime.UTC)
    # As a port of 115200 baud hands it over: some bytes at a time.
    parts = [output[at : at + 500] for at in range(0, len(output), 500)]
    items = [item for part in parts for item in decoder.feed(part, 0.0, now)]
    assert decoder.counters.link.frames_damaged == 0
    detector, detected = None, list[DetectedItem]()
    for item in items:
        if isinstance(item, Connected):
            detector = Detector(setup.identity_with(item.identity), setup.device.detection)
            stream = None
        elif isinstance(item, Samples | Gap):
            assert detector is not None
            if item.stream != stream:  # as a session does
                detector.begin(item.stream, item.first)
                stream = item.stream
            detected += detector.feed(item)
    assert detector is not None
    detected += detector.finish("the lines end")
    drops = [each for each in detected if isinstance(each, RawDrop)]
    assert len(drops) == 2
    for drop in drops:
        assert drop.missing == ()
        peak = int(np.argmax(np.abs(drop.counts[:, 0])))
        at = int(np.flatnonzero(played.counts[:, 0] == drop.counts[peak, 0])[0]) - peak
        np.testing.assert_array_equal(drop.counts, played.counts[at : at + len(drop.counts)])
