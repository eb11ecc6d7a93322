"""How messages travel between agents; `covey.transports.zenoh` is imported where it is needed."""

from covey.transports.base import RealTransport, Transport
from covey.transports.loopback import Loopback, LoopbackEndpoint, Step

__all__ = ["Loopback", "LoopbackEndpoint", "RealTransport", "Step", "Transport"]
