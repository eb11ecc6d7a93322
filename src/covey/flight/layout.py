"""The columns of the arrays that flight works on; one row a vehicle."""

from __future__ import annotations

GRAVITY = 9.81
"""Standard gravity as used throughout, m/s²."""

ON_GROUND = 0.3
"""A vehicle whose centre is lower than this, metres, does not count for the separation in the air: it takes off, lands
or stands.
"""

# state, and its first OBSERVATION columns as measured
P = 0
"""Position, frame W, metres, 3 columns."""
V = 3
"""Velocity, frame W, m/s, 3 columns."""
QUAT = 6
"""Rotation of B to W as a unit quaternion (w, x, y, z), 4 columns."""
OMEGA = 10
"""Angular velocity, frame B, rad/s, 3 columns."""
OBSERVATION = 13
"""Columns of an observation."""
ROTORS = 13
"""Rotor speeds, rad/s, 4 columns."""
STATE = 17
"""Columns of a state."""

# command: normalised thrust (m/s²) along B's z, then omega_B (rad/s)
COMMAND = 4
"""Columns of a command."""

# reference
REF_P = 0
REF_V = 3
REF_A = 6
REF_J = 9
REF_YAW = 12
REF_YAW_RATE = 13
REFERENCE = 14
"""Columns of a reference: position, velocity, acceleration, jerk (frame W), yaw and yaw rate."""

# signals of the controller
SIG_V1 = 0
SIG_V2 = 1
SIG_V3 = 2
SIG_DV3 = 3
SIG_EP = 4
SIG_EV = 5
SIGNALS = 6
"""Columns of the controller's signals: V1, V2, V3, dV3/dt, norms of position and velocity error."""
