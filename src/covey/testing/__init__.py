"""Conformance suites: what every implementation of an interface must do."""

from covey.testing.optimizers import check_pose_optimizer, check_pose_result
from covey.testing.simulators import check_simulator
from covey.testing.transports import check_real_transport, check_transport
from covey.testing.visibility import check_visibility_model

__all__ = [
    "check_pose_optimizer",
    "check_pose_result",
    "check_real_transport",
    "check_simulator",
    "check_transport",
    "check_visibility_model",
]
