"""Opens the port of one instrument, and the same one again wherever it is found later."""

from pfwd_device.errors import PortError
from pfwd_device.transport import ports
from pfwd_device.transport.base import Transport
from pfwd_device.transport.opening import BAUD_RATE, open_transport


class PortFinder:
    """A transport whenever it is called, to the USB adapter that was there the first time.

    Parameters
    ----------
    url : str
        See `pfwd_device.transport.opening.open_transport`.
    baud_rate : int
        Of a serial port.
    """

    def __init__(self, url: str, baud_rate: int = BAUD_RATE) -> None:
        self._url = url
        self._baud_rate = baud_rate
        self._adapter: ports.Adapter | None = None
        self._turn = 0

    def __call__(self) -> Transport:
        """An open transport.

        Raises
        ------
        PortError
            If it cannot be opened, or the adapter is not there.
        """
        places = ports.find_again(self._url, self._adapter)
        if not places:
            raise PortError(
                f"{self._url}: expected the adapter that was there before, got another one; plug "
                "the instrument's own adapter in again"
            )
        # Adapters without a serial number are all alike: ask one after the other.
        place = places[self._turn % len(places)]
        self._turn += 1
        transport = open_transport(place, self._baud_rate)
        if self._adapter is None:
            self._adapter = ports.adapter_of(place)
            self._turn = 0
        return transport
