"""Surveys that a session without inversion records from a script."""

from pathlib import Path
from typing import Any

from pfwd_device.acquisition.decoder import Decoder
from pfwd_device.acquisition.items import Item
from pfwd_device.recording import SurveyWriter
from pfwd_device.wire.binary import BinaryDialect, encode_message
from pfwd_device.wire.messages import Hello, Start
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.scenario import load_scenario
from tests.pfwd.scripted_feed import NOW, Log, ScriptedFeed, began, pieces, run, stream


def record(folder: Path, *parts: Any, log: Log | None = None, **plan: Any) -> Log:
    """Record what a script sends into the survey of a folder; return what was reported."""
    log = Log() if log is None else log
    with SurveyWriter.open(folder, publish=False) as writer:
        run(ScriptedFeed(*parts), log, writer, **plan)
    return log


def simulated(
    scenario: dict[str, Any], *seconds: float, drops: int, step: float = 10.0
) -> tuple[list[Item], PortlessInstrument, Decoder]:
    """Let a simulated instrument run as often as seconds are given, each time asked to start."""
    instrument = PortlessInstrument(load_scenario(scenario), drops=drops, overruns=False)
    decoder = Decoder(BinaryDialect())
    items: list[Item] = []
    for duration in seconds:
        for command in (Hello(), Start()):
            instrument.receive(encode_message(command, 0))
        while duration > 0:
            instrument.advance(min(step, duration))
            duration -= step
            items += decoder.feed(bytes(instrument.output), instrument.time, NOW)
            instrument.output.clear()
    return items, instrument, decoder


def drops(*peaks: float, run: int = 1) -> list[Any]:
    """Run of samples with a drop every 3 s, the first after 1 s; the peaks are in N."""
    pulses = [(1.0 + 3 * number, peak) for number, peak in enumerate(peaks)]
    return [began(run), *pieces(stream(3.0 * len(peaks) + 1, pulses, seed=run), run)]
