"""Test whether an instrument meets the requirements of the protocol in docs/protocol.md.

The requirements have the numbers P-1 to P-42. Each is tested by a function of this package that
receives an `InstrumentLink`, returns a short description of the behaviour of the instrument, and
raises `Failed` if the requirement is not met, or `NotSupported` if the instrument lacks the
function. `pfwd_device.wire.messages` explains the messages (Hello, Identity, Offer, ...).
"""

from pfwd_device.conformance.run import Result, conform

__all__ = ["Result", "conform"]
