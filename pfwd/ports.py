"""The ports of this computer and what answers at them, for the terminal.

Shut off here, so that the terminal need not know how an instrument is spoken to.
"""

from collections.abc import Sequence

from pfwd_device.acquisition.probing import PROBE_TIMEOUT, Probe, probe_all
from pfwd_device.transport.ports import Adapter, Port, list_ports
from pfwd_device.wire.registry import all_dialects

__all__ = ["Adapter", "Port", "Probe", "list_ports", "probe_ports"]


def probe_ports(urls: Sequence[str], timeout: float = PROBE_TIMEOUT) -> list[Probe]:
    """What answers at each of some ports, in their order; a few seconds for all together."""
    return probe_all(urls, all_dialects(), timeout)
