"""Comparison of an instrument's calibration with that of the drops already recorded with it."""

from collections.abc import Callable, Iterator

from pfwd.errors import OptionError
from pfwd.session.events import CalibrationChanged, Repeats
from pfwd.session.survey_recorder import SurveyRecorder
from pfwd_device.errors import RecordingError, SetupError
from pfwd_device.identity import ChannelIdentity, Identity, identity_from_dict
from pfwd_device.recording import SurveyWriter


def calibration_changes(before: Identity, now: Identity) -> tuple[str, ...]:
    """Return the changes of calibration by which the same raw counts give other SI values.

    Parameters
    ----------
    before, now : Identity
        Identities of the same instrument, with the values of the setup file.

    Returns
    -------
    tuple of str
        One phrase for each change; empty: no change.
    """
    return tuple(_changes(before, now))


def _changes(before: Identity, now: Identity) -> Iterator[str]:
    if before.adc_range != now.adc_range:
        yield f"range of the converter is {now.adc_range:g} V, was {before.adc_range:g} V"
    if before.adc_bits != now.adc_bits:
        yield f"converter has {now.adc_bits} bits, had {before.adc_bits}"
    if len(before.channels) != len(now.channels):
        yield f"channels are {len(now.channels)}, were {len(before.channels)}"
        return
    for earlier, channel in zip(before.channels, now.channels, strict=True):
        yield from _channel_changes(earlier, channel)


def _channel_changes(before: ChannelIdentity, now: ChannelIdentity) -> Iterator[str]:
    name = now.name
    if before.name != name:
        yield f"channel {name!r} replaces {before.name!r}"
    if before.quantity is not now.quantity:
        yield f"role of {name} is {now.quantity.role}, was {before.quantity.role}"
    sensitivity = f"V per {now.quantity.unit}"
    for quantity, unit, value, earlier in (
        ("sensitivity", sensitivity, now.sensitivity, before.sensitivity),
        ("zero", "V", now.zero, before.zero),
        ("range", "V", now.adc_range, before.adc_range),
        ("delay", "s", now.delay, before.delay),
        ("natural frequency", "Hz", now.natural_frequency, before.natural_frequency),
        ("damping ratio", "", now.damping, before.damping),
    ):
        if value != earlier:
            yield f"{quantity} of {name} is {_text(value, unit)}, was {_text(earlier, unit)}"


def _text(value: float | None, unit: str) -> str:
    return "not declared" if value is None else f"{value:.9g} {unit}".rstrip()


def last_recorded_identity(writer: SurveyWriter, serial_number: str) -> Identity | None:
    """Return the identity of an instrument that was recorded with its last drop.

    Parameters
    ----------
    writer : SurveyWriter
        Survey to search.
    serial_number : str
        Serial number of the instrument.

    Returns
    -------
    Identity or None
        None: the survey has no drop of this instrument.
    """
    for drop in reversed(writer.contents().drops):
        if not (drop.key or "").startswith(f"{serial_number}/"):
            continue  # the drop is of another instrument, or imported
        try:
            identity = identity_from_dict(drop.read().metadata["identity"])
        except (RecordingError, SetupError, KeyError, TypeError):
            continue  # damaged, or written by another program
        if identity.serial_number == serial_number:
            return identity
    return None


class CalibrationCheck:
    """Comparison of the calibration of connected instruments with that of their earlier drops.

    Parameters
    ----------
    report : callable
        Receives the changes.
    recorder : SurveyRecorder or None
        Survey of a measurement; None: nothing is compared.
    choice : "ask", "accept" or "refuse"
        Treatment of a changed calibration.
    """

    def __init__(
        self,
        report: Callable[[CalibrationChanged], None],
        recorder: SurveyRecorder | None,
        choice: str,
    ) -> None:
        self._report, self._recorder, self._choice = report, recorder, choice
        self._stored_events = Repeats()
        self._calibrated: dict[str, Identity] = {}
        """Identities with accepted calibration, by serial number."""
        self.accepted: set[CalibrationChanged] = set()
        """Changes that the operator has accepted."""
        self.unanswered: CalibrationChanged | None = None
        """Latest change for which the operator was asked."""

    def is_accepted(self, identity: Identity) -> bool:
        """Compare the calibration of an instrument with that of its earlier drops in the survey.

        Returns
        -------
        bool
            False: it has changed, and the operator has to accept that first.

        Raises
        ------
        OptionError
            If it has changed, and changes are to be refused.
        """
        serial = identity.serial_number
        if self._recorder is None or not serial:
            return True
        before = self._calibrated.get(serial)
        if before is None:
            before = last_recorded_identity(self._recorder.writer, serial)
        changes = () if before is None else calibration_changes(before, identity)
        if changes:
            text = f"calibration of {serial} changed since its last drop in this survey: "
            event = CalibrationChanged(text + "; ".join(changes), waits=self._choice == "ask")
            if self._choice == "refuse":
                raise OptionError(
                    f"{event.text}. Nothing is recorded: check the instrument and the setup file, "
                    "then give --accept-calibration, or begin another survey"
                )
            if self._choice == "ask" and event not in self.accepted:
                self.unanswered = event
                self._report(event)
                return False
            if self._choice == "accept":
                self._report(event)
            if (n_unreported := self._stored_events.due("calibration")) is not None:
                details = {"serial_number": serial, "changes": list(changes)}
                more = {"more_before": n_unreported} if n_unreported else {}
                self._recorder.keep_event("calibration changed", details | more)
        self._calibrated[serial] = identity
        return True
