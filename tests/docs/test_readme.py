"""What the README and the other pages tell a reader to type works as it stands there."""

from __future__ import annotations

import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(?P<language>\w+)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!\w+:|#)(?P<target>[^)#\s]+)")


def blocks(page: Path, *languages: str) -> list[str]:
    """Code blocks of a page in these languages."""
    return [match["body"] for match in BLOCK.finditer(page.read_text("utf-8")) if match["language"] in languages]


def covey_lines(page: Path) -> list[list[str]]:
    """Arguments of every `covey` command line on a page."""
    lines = "\n".join(blocks(page, "sh", "console", "bash")).replace("\\\n", " ").splitlines()
    words = [shlex.split(line.removeprefix("$ "), comments=True) for line in lines]
    return [line[1:] for line in words if line and line[0] == "covey"]


def run(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run covey in a process of its own, as a reader would."""
    program = "from covey.cli.main import main; main()"
    command = [sys.executable, "-W", "error", "-c", program, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


def serve(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command that serves until Ctrl-C, and press it when the page is there."""
    program = "from covey.cli.main import main; main()"
    command = [sys.executable, "-W", "error", "-c", program, *arguments]
    with subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        err = ""
        for line in process.stderr:
            err += line
            if "until you press Ctrl-C" in line:
                process.send_signal(signal.SIGINT)
    return subprocess.CompletedProcess(command, process.returncode, "", err)


def serves(arguments: list[str]) -> bool:
    """Whether a command serves a page until Ctrl-C."""
    return arguments[0] == "playground" or (arguments[0] == "replay" and not {"--html", "--video"} & set(arguments))


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with what a reader has, to run commands in."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_readme_opens_with_the_two_commands_and_a_picture() -> None:
    opening = (ROOT / "README.md").read_text("utf-8").splitlines()[:20]
    places = [next(i for i, line in enumerate(opening) if text in line) for text in ("make demo", "make test", "![")]
    assert places == sorted(places)


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 120


def test_commands_of_the_readme_run(clone: Path) -> None:
    yaml = blocks(ROOT / "README.md", "yaml")
    assert len(yaml) == 1
    (clone / "mission.yaml").write_text(yaml[0], "utf-8")
    lines = covey_lines(ROOT / "README.md")
    assert {line[0] for line in lines} >= {"plan", "validate", "certify"}
    for line in lines:
        finished = serve(line, clone) if serves(line) else run(line, clone)
        assert finished.returncode == 0, f"covey {shlex.join(line)}\n{finished.stdout}\n{finished.stderr}"


def test_python_of_the_readme_runs(clone: Path) -> None:
    program = "\n".join(blocks(ROOT / "README.md", "python"))
    assert "import covey" in program
    (clone / "mission.yaml").write_text(blocks(ROOT / "README.md", "yaml")[0], "utf-8")
    finished = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], cwd=clone, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_flags_on_every_page_exist(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("TERM", "dumb")
    for line in covey_lines(page):
        named = [line[0]] if line and not line[0].startswith("-") else []
        shown = run([*named, "--help"], tmp_path)
        assert shown.returncode == 0, shown.stderr
        flags = {word.split("=")[0] for word in line if word.startswith("--")}
        assert flags <= set(re.findall(r"--[\w-]+", shown.stdout)), shlex.join(line)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_of_every_page_lead_somewhere(page: Path) -> None:
    targets = {match["target"] for match in LINK.finditer(page.read_text("utf-8"))}
    assert sorted(target for target in targets if not (page.parent / target).exists()) == []


def test_make_targets_on_every_page_exist() -> None:
    rules = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    for page in PAGES:
        named = set(re.findall(r"`make (\w+)`|^make (\w+)", page.read_text("utf-8"), re.MULTILINE))
        assert {first or second for first, second in named} <= rules, page.name
