"""The file that says how a team talks: read, combined with options, and every mistake at once with its line."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.unit.runtime.small import small

from covey.errors import ArgumentError, MissionError
from covey.mission import Mission
from covey.protocol import Adopt
from covey.runtime.network.network_file import NetworkPlan, load_network
from covey.transports.network import Mode

WHOLE = """
listen = ["tls/192.0.2.10:7447"]
connect = ["tls/192.0.2.11:7447", "quic/192.0.2.12:7447"]
lease_s = 1.5
heartbeat_s = 0.25
dead_after_s = 2.0
map_s = 5.0
adopt = "majority"

[credentials]
authority = "authority.pem"
certificate = "certs/{name}.pem"
key = "certs/{name}.key"
verify_name = false

[access]
agents = {blue = "robot-b", red = "robot-r"}
observers = ["ground"]
"""


@pytest.fixture
def mission() -> Mission:
    return small()


def load(tmp_path: Path, text: str, mission: Mission, name: str = "net.toml") -> NetworkPlan:
    path = tmp_path / name
    path.write_text(text, "utf-8")
    return load_network(path, mission)


def test_everything_is_read(tmp_path: Path, mission: Mission) -> None:
    plan = load(tmp_path, WHOLE, mission)
    options, times = plan.options, plan.times
    assert options.listen == ("tls/192.0.2.10:7447",)
    assert options.connect == ("tls/192.0.2.11:7447", "quic/192.0.2.12:7447")
    assert (options.mode, options.multicast, options.lease) == (Mode.PEER, False, 1.5)
    assert (times.heartbeat_every, times.dead_after, times.map_every) == (0.25, 2.0, 5.0)
    assert times.adopt is Adopt.MAJORITY
    assert options.access is not None
    assert dict(options.access.agents) == {0: "robot-b", 1: "robot-r"}
    assert options.access.observers == ("ground",)


def test_the_name_of_an_agent_chooses_its_certificate(tmp_path: Path, mission: Mission) -> None:
    plan = load(tmp_path, WHOLE, mission).for_name("blue")
    files = plan.options.credentials
    assert files is not None
    assert files.certificate == tmp_path / "certs" / "blue.pem"
    assert files.key == tmp_path / "certs" / "blue.key"
    assert files.authority == tmp_path / "authority.pem"
    assert NetworkPlan().for_name("blue") == NetworkPlan()


def test_nothing_is_needed(tmp_path: Path, mission: Mission) -> None:
    assert load(tmp_path, "# by default\n", mission) == NetworkPlan()
    assert load(tmp_path, "{}", mission, "net.yaml") == NetworkPlan()


def test_options_replace_what_the_file_says(tmp_path: Path, mission: Mission) -> None:
    plan = load(tmp_path, 'listen = ["tcp/127.0.0.1:1"]\nconnect = ["tcp/127.0.0.1:2"]', mission)
    assert plan.joined() == plan
    assert plan.joined(listen=("tcp/127.0.0.1:3",)).options.listen == ("tcp/127.0.0.1:3",)
    assert plan.joined(connect=("tcp/127.0.0.1:3",)).options.connect == ("tcp/127.0.0.1:3",)
    routed = plan.joined(router="tcp/192.0.2.1:7447").options
    assert (routed.mode, routed.connect, routed.endpoints) == (Mode.CLIENT, ("tcp/192.0.2.1:7447",), ())
    with pytest.raises(ArgumentError, match="--router"):
        plan.joined(router="tcp/192.0.2.1:7447", listen=("tcp/127.0.0.1:3",))
    with pytest.raises(ArgumentError, match="tls/"):
        load(tmp_path, WHOLE, mission).joined(connect=("tcp/127.0.0.1:3",))


def test_a_router_in_the_file(tmp_path: Path, mission: Mission) -> None:
    options = load(tmp_path, 'router = "tcp/192.0.2.1:7447"', mission).options
    assert (options.mode, options.connect) == (Mode.CLIENT, ("tcp/192.0.2.1:7447",))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lisen = []", "unknown key 'lisen' (did you mean 'listen'?)"),
        ("colour = 3", "(known here: listen, connect, router, multicast, lease_s"),
        ('listen = "tcp/127.0.0.1:1"', "net.toml:1:1: listen: expected a list"),
        ('listen = ["127.0.0.1"]', "listen: expected one such as tcp/192.0.2.10:7447, got '127.0.0.1'"),
        ('connect = ["tcp/localhost"]', "connect: expected one such as tcp/192.0.2.10:7447, got 'tcp/localhost'"),
        ('router = ""', "router: expected one such as"),
        ("lease_s = 0.0", "lease_s: expected a number above 0"),
        ("heartbeat_s = 2.0", "dead_after_s: expected at least three heartbeats, 6"),
        ("lease_s = 10.0", "dead_after_s: expected at least lease_s = 10"),
        ('adopt = "some"', "adopt: expected 'all' or 'majority'"),
        ('[access]\nagents = {pink = "p"}', "expected an agent of the mission: blue, green, red"),
        ('[access]\nagents = {blue = "b"}', "access: expected a section credentials too"),
        ('[credentials]\nauthority = "a"', "credentials.key: expected this key, it is missing"),
        (WHOLE.replace("quic/", "tcp/"), "connect: expected tls/ or quic/ endpoints with credentials"),
        ('router = "tcp/a:1"\nlisten = ["tcp/b:1"]', "listen: expected nothing with a router"),
        ("listen = [", "not valid TOML"),
        ("- 1", "not valid TOML"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, mission: Mission, text: str, said: str) -> None:
    with pytest.raises(MissionError) as caught:
        load(tmp_path, text, mission)
    assert said in str(caught.value)
    assert "net.toml" in str(caught.value)


def test_all_mistakes_are_named_at_once(tmp_path: Path, mission: Mission) -> None:
    with pytest.raises(MissionError) as caught:
        load(tmp_path, "lease_s = -1.0\nmap_s = 'x'\nadopt = 'none'", mission)
    assert [mistake.line for mistake in caught.value.mistakes] == [1, 2, 3]


def test_files_that_are_no_such_file(tmp_path: Path, mission: Mission) -> None:
    with pytest.raises(MissionError, match=r"expected a file name ending in \.toml"):
        load(tmp_path, "x", mission, "net.txt")
    with pytest.raises(MissionError, match=r"absent\.toml"):
        load_network(tmp_path / "absent.toml", mission)
    with pytest.raises(MissionError, match="a mapping"):
        load(tmp_path, "[1, 2]", mission, "net.json")
