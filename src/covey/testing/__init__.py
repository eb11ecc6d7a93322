"""Conformance suites: what every implementation of an interface must do."""

from covey.testing.transports import check_transport

__all__ = ["check_transport"]
