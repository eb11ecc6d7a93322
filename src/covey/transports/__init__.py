"""How messages travel between agents."""

from covey.transports.base import Transport
from covey.transports.loopback import Loopback, LoopbackEndpoint, Step

__all__ = ["Loopback", "LoopbackEndpoint", "Step", "Transport"]
