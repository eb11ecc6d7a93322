"""Strangers on the network of real processes change nothing and are reported."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from tests.certificates import Authority
from tests.net import PATIENCE
from tests.unit.runtime.launched import LONG_ENOUGH, LONGEST, check, write_small
from tests.unit.runtime.small import check_deployment

from covey.mission import Mission, load_mission
from covey.protocol import Heartbeat, PoseRecord, Sender
from covey.runtime.network.launch import LaunchOptions, launch
from covey.runtime.network.network_file import load_network
from covey.runtime.network.remote_agent import mission_codec
from covey.transports.codec import Codec
from covey.transports.network import Credentials, NetworkOptions, mission_prefix
from covey.transports.zenoh import ZenohTransport


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a small mission."""
    return write_small(tmp_path)


class Stranger(threading.Thread):
    """Somebody on the network who is up to no good, until the mission is over."""

    def __init__(self, mission: Mission, endpoints: Sequence[str], credentials: Credentials | None = None) -> None:
        super().__init__(daemon=True)
        self.mission = mission
        self.endpoints = tuple(endpoints)
        self.credentials = credentials
        self.stopped = threading.Event()
        self.replayed = 0

    def run(self) -> None:
        codec = mission_codec(self.mission)
        other = Codec(bytes(16), agents=codec.agents, landmarks=codec.landmarks)
        prefix = mission_prefix(codec.digest)
        options = NetworkOptions(connect=self.endpoints, credentials=self.credentials)
        elsewhere = ZenohTransport(Sender(0, 1), other, options)
        overheard: list[tuple[str, bytes]] = []
        session = elsewhere._session

        def overhear(sample: zenoh.Sample) -> None:
            if len(overheard) < 50:
                overheard.append((str(sample.key_expr), sample.payload.to_bytes()))

        session.declare_subscriber(f"{prefix}/state/*", overhear, allowed_origin=zenoh.Locality.REMOTE)
        pose = PoseRecord(99, 99, self.mission.agents[0].pose)
        while not self.stopped.wait(0.02):
            for agent in range(len(self.mission.agents)):
                lie = Heartbeat(Sender(0, 2**40), 1, True, 1, pose, {}, {}, b"12345678")
                foreign = other.encode(lie, sender=lie.sender, number=1)
                impostor = codec.encode(lie, sender=Sender((agent + 1) % len(self.mission.agents), 1), number=1)
                for data in (b"", b"garbage", os.urandom(200), foreign, impostor):
                    session.put(f"{prefix}/state/{agent}", data)
                    session.put(f"{prefix}/log/{agent}", data)
                    session.put(f"{prefix}/change", data)
                    session.get(f"{prefix}/trade/{agent}/1", zenoh.handlers.FifoChannel(4), payload=data, timeout=1.0)
            for key, data in list(overheard):
                self.replayed += 1
                session.put(key, data)
        elsewhere.close()

    def stop(self) -> None:
        """Leave."""
        self.stopped.set()
        self.join(PATIENCE)


@contextmanager
def strangers() -> Iterator[list[Stranger]]:
    there: list[Stranger] = []
    try:
        yield there
    finally:
        for stranger in there:
            stranger.stop()


def test_a_stranger_changes_nothing_and_is_reported(path: Path) -> None:
    mission = load_mission(path)
    with strangers() as there:

        def invite(endpoints: Sequence[str]) -> None:
            there.append(Stranger(mission, endpoints))
            there[0].start()

        options = LaunchOptions(blows=LONG_ENOUGH, timeout=LONGEST)
        deployment, report = launch(mission, path, options, on_endpoints=invite)
        assert there[0].replayed > 0
    check(deployment, report)
    check_deployment(deployment)
    assert report.died == ()
    counts = report.strangers
    assert {"malformed", "another mission", "impostor", "replayed"} <= set(counts), counts
    assert all(agent["dropped"].get("malformed") for agent in report.agents)
    assert all(agent["other_missions"] == [bytes(16).hex()] for agent in report.agents)
    assert not [entry for entry in deployment.history if entry.event in ("death", "return", "abandoned")]


def secure(folder: Path, authority: Authority, names: Sequence[str]) -> Path:
    """Write a network file of a team with certificates."""
    for name in (*names, "observer"):
        files = authority.issue(name)
        files.certificate.rename(folder / f"{name}.pem")
        files.key.rename(folder / f"{name}.key")
    agents = ", ".join(f'{name} = "{name}"' for name in names)
    text = f"""
        [credentials]
        authority = "{authority.path.name}"
        certificate = "{{name}}.pem"
        key = "{{name}}.key"
        [access]
        agents = {{{agents}}}
        observers = ["observer"]
    """
    (folder / "net.toml").write_text(text, "utf-8")
    return folder / "net.toml"


def test_with_certificates_a_stranger_is_not_even_let_in(path: Path, tmp_path: Path) -> None:
    mission = load_mission(path)
    authority, forger = Authority(tmp_path), Authority(tmp_path, "forger")
    file = secure(tmp_path, authority, [agent.name for agent in mission.agents])
    plan = load_network(file, mission)
    options = LaunchOptions(network=plan, network_file=file, blows=LONG_ENOUGH, timeout=LONGEST)
    forged = forger.issue("blue", trusted=authority.path)
    with strangers() as there:

        def invite(endpoints: Sequence[str]) -> None:
            there.append(Stranger(mission, endpoints, forged))
            there[0].start()

        deployment, report = launch(mission, path, options, on_endpoints=invite)
        assert there[0].replayed == 0
    check(deployment, report)
    assert report.died == ()
    assert report.strangers == {}
    assert len(report.agents) == len(mission.agents)
    assert sum(report.refused.values()) > 0
    assert all("certificate" in why for why in report.refused), report.refused
