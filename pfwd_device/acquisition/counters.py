"""Counters of received and discarded data of an instrument."""

from dataclasses import dataclass, field

from pfwd_device.wire.dialect import LinkCounters


@dataclass(slots=True)
class Counters:
    """Counts since the driver was made; nothing is discarded without being counted here."""

    link: LinkCounters = field(default_factory=LinkCounters)
    """Bytes and frames."""
    queue_overflow_bytes: int = 0
    """Bytes thrown away because the program was too slow to read them."""
    capture_failures: int = 0
    """Chunks of bytes that could not be recorded for replay."""
    samples: int = 0
    """Samples passed on; all channels together count as one."""
    samples_repeated: int = 0
    """Samples discarded as duplicates, or because their gap had been reported."""
    samples_lost: int = 0
    """Samples in gaps."""
    samples_early: int = 0
    """Samples discarded because the buffer for those before the identity was full."""
    blocks_refused: int = 0
    """Blocks with another number of channels than the identity, or with an impossible index."""
    samples_recovered: int = 0
    """Samples that were lost in transfer and received by a repeated request."""
    blocks_repeated: int = 0
    """Blocks of buffered drops that had been received before."""
    transfers_abandoned: int = 0
    """Incomplete buffered drops whose blocks were discarded to make room; they stay in the
    instrument and are transferred again."""
    drops_kept: int = 0
    """Drops detected by the instrument and received completely."""
    streams: int = 0
    """Runs of the sampler."""
    reconnects: int = 0
    """Number of times that the lost instrument was connected again."""
    instrument_resets: int = 0
    """Number of restarts that the instrument reported during the session."""
    instrument_overruns: int = 0
    """Samples that the instrument itself discarded, summed over its resets."""
    clock_jumps: int = 0
    """Jumps of the instrument's clock."""
