"""Ports that nobody else takes."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from covey.errors import NetworkError
from covey.transports import ports
from covey.transports.ports import LEAST, PORTS, free_endpoints


def number(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


@pytest.fixture
def dialling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that says which ports are given to sockets that dial."""
    file = tmp_path / "range"
    monkeypatch.setattr(ports, "_RANGE", file)
    return file


@pytest.mark.parametrize("text", ["32768\t60999\n", "10000 20000", "20001 65535"])
def test_no_port_is_one_of_those_for_dialling(dialling: Path, text: str) -> None:
    dialling.write_text(text, encoding="ascii")
    low, high = (int(word) for word in text.split())
    for endpoint in free_endpoints(300):
        assert number(endpoint) in PORTS
        assert not low <= number(endpoint) <= high


@pytest.mark.parametrize("text", [None, "", "all of them"])
def test_the_common_range_is_taken_where_the_system_does_not_say(dialling: Path, text: str | None) -> None:
    if text is not None:
        dialling.write_text(text, encoding="ascii")
    assert all(number(endpoint) < 49_152 for endpoint in free_endpoints(300))


def test_all_ports_are_used_where_few_are_left(dialling: Path) -> None:
    dialling.write_text(f"1024 {65_535 - LEAST + 1}", encoding="ascii")
    assert min(number(endpoint) for endpoint in free_endpoints(20)) < 65_535 - LEAST


def test_a_port_with_a_listener_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        taken = other.getsockname()[1]
        monkeypatch.setattr(ports, "PORTS", range(taken, taken + 1))
        with pytest.raises(NetworkError, match="of 1 ports for agents only 0 are free"):
            free_endpoints(1)
    assert free_endpoints(1) == [f"tcp/127.0.0.1:{taken}"]


def test_ports_differ_and_can_be_listened_on() -> None:
    endpoints = free_endpoints(50, "tls")
    assert len(set(endpoints)) == 50
    for endpoint in endpoints:
        assert endpoint.startswith("tls/127.0.0.1:")
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", number(endpoint)))
            listener.listen()
