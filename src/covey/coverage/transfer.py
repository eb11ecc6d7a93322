"""The transfer routine of a trade: who gets which landmark when poses stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def transfer(
    server_visibility: NDArray[np.float64],
    client_visibility: NDArray[np.float64],
    server_landmarks: NDArray[np.int64],
    client_landmarks: NDArray[np.int64],
    sigma: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Give each landmark to the partner if it is seen better there by more than sigma.

    Parameters
    ----------
    server_visibility, client_visibility : arrays, shape (n,)
        Visibility of every landmark from each side's committed pose.
    server_landmarks, client_landmarks : arrays, shape (k,)
        Sorted indices of what each side owns.
    sigma : float
        Tolerance.

    Returns
    -------
    tuple of two arrays
        Sorted indices of what server and client own afterwards.

    Notes
    -----
    Source: Sposato (2016), Algorithm 6.  Deviation: V2.

    Examples
    --------
    >>> transfer(np.array([1.0, 0.0]), np.array([0.0, 1.0]), np.array([1]), np.array([0]), 0.01)
    (array([0]), array([1]))
    """
    advantage = client_visibility - server_visibility
    give = advantage[server_landmarks] > sigma
    want = advantage[client_landmarks] < -sigma
    server = np.concatenate([server_landmarks[~give], client_landmarks[want]])
    client = np.concatenate([client_landmarks[~want], server_landmarks[give]])
    server.sort()
    client.sort()
    return server, client
