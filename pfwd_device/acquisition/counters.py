"""Everything that was received from an instrument, and everything of it that was thrown away."""

from dataclasses import dataclass, field

from pfwd_device.wire.dialect import LinkCounters


@dataclass(slots=True)
class Counters:
    """Counts since the driver was made; nothing is discarded without being counted here."""

    link: LinkCounters = field(default_factory=LinkCounters)
    """Bytes and frames."""
    queue_overflow_bytes: int = 0
    """Bytes thrown away because the program was too slow to look at them."""
    capture_failures: int = 0
    """Chunks of bytes that could not be kept for replay."""
    samples: int = 0
    """Samples (of all channels together one) handed on."""
    samples_repeated: int = 0
    """Samples that came again, or after their gap had been told, and were dropped."""
    samples_lost: int = 0
    """Samples in gaps."""
    samples_early: int = 0
    """Samples that came before the instrument had said what it is, more than could be kept."""
    blocks_refused: int = 0
    """Blocks with another number of channels than the identity, or with an impossible index."""
    samples_recovered: int = 0
    """Samples that were lost on the way and came when they were asked for again."""
    blocks_repeated: int = 0
    """Blocks of buffered drops that had been received before."""
    transfers_abandoned: int = 0
    """Incomplete buffered drops whose blocks were discarded to make room; they stay in the
    instrument and are transferred again."""
    drops_kept: int = 0
    """Drops that the instrument found itself and that came whole."""
    streams: int = 0
    """Runs of the sampler."""
    reconnects: int = 0
    """How often the instrument was lost and found again."""
    instrument_resets: int = 0
    """How often it said that it had just started, in the middle of the work."""
    instrument_overruns: int = 0
    """Samples that the instrument itself has thrown away, across its resets."""
    clock_jumps: int = 0
    """Jumps of the instrument's clock."""
