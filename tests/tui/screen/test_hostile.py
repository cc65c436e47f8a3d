"""Text from device, files and operator reaches neither mark-up nor the terminal's controls."""

import datetime
import logging
import re
import unicodedata
from pathlib import Path
from typing import Any

from pfwd.analysis.results import DiagnosisResult
from pfwd.judging import PointView
from pfwd.session.events import Edited, InstrumentLost, SessionNotice, SurveyRead
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_plugins.quantities import Measurand
from tests.records import read
from tests.tui.results import result
from tests.tui.screen.scripted import (
    NOON,
    App,
    QuietSource,
    analysed,
    deliver,
    play,
    ready,
    saved,
    status,
)
from tui.log_file import survey_log
from tui.screen.session.event_log import log_event
from tui.screen.session.screen_events import DiagnosisFinished, Refit, SessionEnded

HOSTILE = [
    "[/ [red]x[/blue]",
    "[@click=app.quit]go[/]",
    "\x1b]0;OWNED\x07 \x9b31m \u202eelpmis",
    "a\x00b\r\nc\td \u2028next $d {0} %s",
    "\N{CJK UNIFIED IDEOGRAPH-4E2D}" * 40,
]


def harmless(text: str) -> bool:
    return all(unicodedata.category(letter) not in ("Cc", "Cf", "Zl", "Zp") for letter in text)


def events(text: str) -> list[Any]:
    identity = Identity(
        serial_number=text[:32],
        model=text[:32],
        firmware=text[:32],
        sampling_rate=1e4,
        adc_bits=24,
        adc_range=8.0,
        channels=(
            ChannelIdentity(text[:32], Measurand.LOAD),
            ChannelIdentity("g", Measurand.VELOCITY),
        ),
        plate_radius=0.15,
    )
    point = PointView(text[:60], title=text, notes=(text,))
    diagnosis = {
        "file": text,
        "device": text,
        "drops": [1],
        "rejected": [text],
        "verdict": "unexplained",
        "warnings": [text],
    }
    return [
        ready(identity, differences=(text,), warnings=(text,)),
        status(),
        saved(1, marks=(text,)),
        analysed(1, warnings=[text], at_bound=[text], model=text, method=text),
        saved(2, status="rejected", reason=text),
        SurveyRead((point,)),
        Refit("7", 1, text, result(refit=text), None),
        DiagnosisFinished("survey", (read(DiagnosisResult, diagnosis),)),
        SessionNotice(text, serious=True),
        InstrumentLost(text, NOON.replace(tzinfo=datetime.UTC)),
        SessionEnded(None, text, 2.0, no_device=True),
    ]


def is_harmless(app: App) -> bool:
    return harmless(app.text.replace("\n", ""))


def test_hostile_text_does_not_disturb_a_page() -> None:
    async def script(app: App, pilot: Any) -> None:
        for text in HOSTILE:
            app.source.title = text
            *running, end = events(text)
            await deliver(app, pilot, *running)
            for keys in (["1"], ["2"], ["3"], ["4"], ["question_mark"], ["escape"]):
                await pilot.press(*keys)
                await pilot.pause()
                app.redraw()
                assert is_harmless(app), (text, keys)
            await deliver(app, pilot, end)
            assert is_harmless(app), text
        assert app._exception is None

    play(App(QuietSource(Path("survey"))), script)


async def test_dialogs_and_the_setup_page_show_markup_as_text(app: App, pilot: Any) -> None:
    await deliver(app, pilot, ready(), saved(1))
    for text in HOSTILE[:2]:
        await deliver(app, pilot, Edited("name", text, "7", None))
        await pilot.press("n")
        await pilot.pause()
        assert is_harmless(app), text
        await pilot.press("escape", "5")
        await pilot.pause()
        page: Any = app.screen
        page._show_ports([(text, "/dev/ttyUSB9", True)])
        app.show_message(text)
        page.draw()
        await pilot.pause()
        assert is_harmless(app), text
        await pilot.press("escape")


def test_the_log_has_a_single_line_per_event(tmp_path: Path) -> None:
    with survey_log(tmp_path):
        for text in HOSTILE:
            for event in events(text):
                log_event(event)
    logging.getLogger().setLevel(logging.WARNING)
    lines = (tmp_path / "log" / "pfwd.log").read_text(encoding="utf-8").split("\n")
    assert len(lines) > 4 * len(HOSTILE)
    assert all(harmless(line) for line in lines)
    assert all(re.match(r"\d{4}-\d\d-\d\dT|    ", line) for line in lines[:-1])
