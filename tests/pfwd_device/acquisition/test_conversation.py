"""Messages to an instrument, with time as a number."""

import pytest

from pfwd_device.acquisition.conversation import Conversation, SampleAction, Stage
from pfwd_device.wire.messages import (
    Configure,
    Event,
    EventKind,
    Hello,
    HostMessage,
    InstrumentMessage,
    Refusal,
    RefusalCode,
    Shunt,
    Start,
    Status,
    Stop,
)
from tests.pfwd_device.acquisition.scripted import block, identity

ACCEPT = [SampleAction.ACCEPT]


class Talk:
    """A conversation and the time."""

    def __init__(self, conversation: Conversation | None = None) -> None:
        self.conversation = conversation or Conversation()
        self.now = 100.0
        self.conversation.opened(self.now)

    def sent_within(self, after: float = 0.0) -> list[HostMessage]:
        """Return the messages sent within some time from now, s."""
        end = self.now + after
        sent: list[HostMessage] = []
        while True:
            self.conversation.tick(self.now)
            sent += self.conversation.outbox
            self.conversation.outbox.clear()
            due = self.conversation.due
            if due is None or due > end or self.conversation.failure:
                self.now = max(self.now, end)
                return sent
            self.now = max(due, self.now)

    def receive(self, *messages: InstrumentMessage) -> list[SampleAction]:
        heard = [self.conversation.receive(message, self.now) for message in messages]
        return [action for action in heard if action is not SampleAction.NO_ACTION]


def status(*, sampling: bool) -> Status:
    return Status(0, None, None, 0, sampling)


def running(conversation: Conversation | None = None) -> Talk:
    talk = Talk(conversation)
    talk.sent_within()
    talk.receive(identity())
    talk.sent_within()
    talk.receive(block(0))
    assert talk.conversation.stage is Stage.RUNNING
    return talk


def test_greet_and_start() -> None:
    talk = Talk()
    assert talk.sent_within(0.7) == [Hello()] * 3
    assert talk.receive(identity()) == ACCEPT
    assert talk.sent_within() == [Start()]
    assert talk.receive(status(sampling=False), block(0)) == []
    assert talk.sent_within(100.0) == []


def test_a_sampling_instrument_is_not_restarted() -> None:
    talk = Talk()
    talk.sent_within()
    assert talk.receive(block(500), identity()) == ACCEPT
    assert talk.sent_within(100.0) == []


def test_the_rate_is_set_once() -> None:
    talk = Talk(Conversation(4000.0))
    talk.sent_within()
    assert talk.receive(block(500), identity(rate=2000.0)) == [SampleAction.SUSPEND]
    assert talk.sent_within() == [Stop(), Configure(4000.0)]
    assert talk.receive(identity(rate=3999.0)) == [SampleAction.ACCEPT_NEW_SETTINGS]
    assert talk.sent_within() == [Start()]
    talk.receive(block(0))
    # The instrument took the nearest; after a loss that is the rate it should have.
    talk.conversation.closed()
    talk.conversation.opened(talk.now)
    talk.sent_within()
    assert talk.receive(identity(rate=3999.0)) == ACCEPT


def test_a_late_answer_to_the_greeting_does_not_answer_the_rate() -> None:
    talk = Talk(Conversation(4000.0))
    assert talk.sent_within(0.5) == [Hello()] * 2
    assert talk.receive(identity(rate=2000.0), identity(rate=2000.0)) == [SampleAction.SUSPEND]
    assert talk.receive(identity(rate=4000.0)) == [SampleAction.ACCEPT_NEW_SETTINGS]


def test_an_instrument_at_rest_is_not_stopped_for_its_rate() -> None:
    talk = Talk(Conversation(4000.0))
    talk.sent_within()
    talk.receive(status(sampling=False), identity(rate=2000.0))
    assert talk.sent_within() == [Configure(4000.0)]


def test_the_requested_rate_is_not_set_twice() -> None:
    talk = Talk(Conversation(2000.0))
    talk.sent_within()
    assert talk.receive(identity(rate=2000.0)) == ACCEPT
    assert talk.sent_within() == [Start()]


@pytest.mark.parametrize(
    ("heard", "sent"),
    [
        ([block(900)], []),
        ([status(sampling=True)], []),
        ([status(sampling=False)], [Start()]),
        ([], [Start()]),
    ],
)
def test_after_a_loss_an_instrument_that_does_not_sample_is_started(
    heard: list[InstrumentMessage], sent: list[HostMessage]
) -> None:
    talk = running()
    talk.conversation.closed()
    talk.conversation.opened(talk.now)
    assert talk.sent_within() == [Hello()]
    assert talk.receive(identity()) == ACCEPT
    assert talk.sent_within() == []
    talk.receive(*heard)
    assert talk.sent_within(0.7) == ([] if not heard else sent)
    assert talk.sent_within(0.1) == ([] if heard else sent)


def test_a_reset_is_answered_from_the_beginning() -> None:
    talk = running()
    assert talk.receive(Event(EventKind.BOOT, 0)) == [SampleAction.SUSPEND]
    assert talk.sent_within() == [Hello()]
    assert talk.receive(identity()) == ACCEPT
    assert talk.sent_within() == [Start()]


def test_an_unexpected_stream_causes_a_greeting() -> None:
    talk = running()
    assert talk.receive(block(0, stream=8)) == [SampleAction.SUSPEND]
    assert talk.sent_within() == [Hello()]
    assert talk.receive(block(20, stream=8), identity()) == ACCEPT
    assert talk.sent_within(100.0) == []


def test_a_stopped_instrument_is_started() -> None:
    talk = running()
    talk.now += 1.1
    assert talk.receive(status(sampling=False)) == [SampleAction.SUSPEND]
    assert talk.sent_within() == [Hello()]
    talk.receive(identity())
    assert talk.sent_within() == [Start()]


def test_an_instrument_at_the_end_of_its_data_is_not_restarted() -> None:
    talk = running()
    talk.receive(Event(EventKind.TRIGGER, 0), Event(EventKind.END, 0))
    talk.now += 1.0
    assert talk.receive(status(sampling=False)) == []
    assert talk.sent_within(100.0) == []


def test_start_is_repeated_but_not_while_the_first_block_fills() -> None:
    talk = Talk()
    talk.sent_within()
    talk.receive(identity())
    assert talk.sent_within(1.5) == [Start()] * 2
    for _ in range(20):
        talk.receive(status(sampling=True))
        assert talk.sent_within(0.5) == []
    assert talk.conversation.failure is None


def test_another_instrument_fails() -> None:
    talk = Talk(Conversation(serial_number="SN-1"))
    talk.sent_within()
    assert talk.receive(identity("SN-2")) == [SampleAction.SUSPEND]
    reason = talk.conversation.failure.reason
    assert "expected the instrument SN-1, got SN-2" in reason


@pytest.mark.parametrize(
    ("stage", "code", "final"),
    [
        (Stage.GREETING, RefusalCode.VERSION, True),
        (Stage.GREETING, RefusalCode.UNKNOWN, False),
        (Stage.CONFIGURING, RefusalCode.ARGUMENT, True),
        (Stage.CONFIGURING, RefusalCode.UNKNOWN, True),
        (Stage.CONFIGURING, RefusalCode.BUSY, False),
        (Stage.STARTING, RefusalCode.FAULT, False),
        (Stage.STARTING, RefusalCode.UNKNOWN, True),
        (Stage.RUNNING, RefusalCode.UNKNOWN, False),
    ],
)
def test_refusals(stage: Stage, code: RefusalCode, final: bool) -> None:
    rate = 4000.0 if stage is Stage.CONFIGURING else None
    talk = Talk(Conversation(rate, response_timeout=3.0))
    talk.sent_within()
    if stage is not Stage.GREETING:
        talk.receive(identity())
        talk.sent_within()
    if stage is Stage.RUNNING:
        talk.receive(block(0))
    assert talk.conversation.stage is stage
    talk.receive(Refusal(code, "because"))
    failure = talk.conversation.failure
    assert (failure is not None and failure.refused) is final
    if final:
        assert "because" in failure.reason
    elif stage is not Stage.RUNNING:
        assert talk.sent_within(0.25) == []  # a refusal makes no requests faster
        assert talk.sent_within(1.0)  # asked again
        talk.sent_within(10.0)
        assert "because" in talk.conversation.failure.reason


def test_wishes() -> None:
    talk = running()
    ask = talk.conversation.request
    assert ask(Shunt(True), talk.now) is SampleAction.NO_ACTION
    ask(Stop(), talk.now)
    assert talk.sent_within() == [Shunt(True), Stop()]
    talk.receive(block(20))
    assert talk.sent_within() == []  # still on its way
    talk.now += 1.5
    talk.receive(block(40))
    assert talk.sent_within() == [Stop()]
    ask(Start(), talk.now)
    assert talk.sent_within() == [Start()]
    talk.receive(block(0, stream=8))
    assert ask(Configure(1000.0), talk.now) is SampleAction.SUSPEND
    assert talk.sent_within() == [Stop(), Configure(1000.0)]
    assert talk.receive(identity(rate=1000.0)) == [SampleAction.ACCEPT_NEW_SETTINGS]
    assert talk.sent_within() == [Start()]


def test_samples_are_requested_only_if_they_are_required() -> None:
    talk = Talk(Conversation(sampling=False))
    talk.sent_within()
    assert talk.receive(identity()) == ACCEPT
    assert talk.sent_within(100.0) == []


def test_an_instrument_without_commands_is_accepted() -> None:
    talk = Talk(Conversation(4000.0, accepts_commands=False))
    talk.sent_within()
    assert talk.receive(identity(), block(0)) == ACCEPT
    assert talk.receive(block(0, stream=8), status(sampling=False)) == []
    assert talk.conversation.stage is Stage.RUNNING


def test_greetings_come_every_three_tenths_for_four_seconds() -> None:
    talk = Talk()
    assert talk.sent_within(3.95) == [Hello()] * 14
    assert talk.conversation.failure is None
    talk.sent_within(0.1)
    assert "within 4 s" in talk.conversation.failure.reason
    assert not talk.conversation.failure.refused
    talk = Talk(Conversation(response_timeout=2.0))
    talk.sent_within(3.0)
    assert "2 s" in talk.conversation.failure.reason


def test_a_reopened_link_starts_with_a_greeting() -> None:
    talk = running()
    talk.receive(Event(EventKind.END, 0))
    talk.conversation.closed()
    assert talk.receive(identity(), block(20)) == [], "nothing is heard of a closed link"
    assert talk.conversation.stage is Stage.CLOSED
    talk.conversation.opened(talk.now)
    assert talk.sent_within() == [Hello()]
    talk.receive(identity())
    talk.receive(status(sampling=False))
    assert talk.sent_within() == [Start()], "the end of before is forgotten"


def test_an_unanswered_request_is_repeated_after_a_second() -> None:
    talk = Talk(Conversation(4000.0))
    talk.sent_within()
    talk.receive(identity(rate=2000.0))
    assert talk.sent_within(0.95) == [Stop(), Configure(4000.0)]
    assert talk.sent_within(0.1) == [Stop(), Configure(4000.0)]


@pytest.mark.parametrize(("since", "stopped"), [(0.28, False), (0.32, True)])
def test_a_status_may_be_older_than_the_blocks_around_it(since: float, stopped: bool) -> None:
    talk = running()
    talk.now += since
    heard = talk.receive(status(sampling=False))
    assert (heard == [SampleAction.SUSPEND]) is stopped


def test_no_timeout_while_bytes_wait() -> None:
    conversation = Conversation(response_timeout=1.0)
    conversation.opened(0.0)
    conversation.tick(5.0, received_all=False)
    assert conversation.failure is None
    conversation.tick(5.0)
    assert conversation.failure is not None
