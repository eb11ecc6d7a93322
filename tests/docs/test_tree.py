"""The tree itself: short files, nothing silenced, no name of one machine or of a registry's host."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILT = {".git", ".venv", "build", "dist", "__pycache__", ".hypothesis", ".mypy_cache", ".ruff_cache", ".pytest_cache"}
MACHINE = re.compile(r"(?<![\w./:~-])/(?:home|root|work|opt|mnt|tmp|Users)/\w")
HOST = re.compile(r"pypi\.org|pythonhosted\.org|registry\.npmjs|index-url\s*=?\s*http|files\.pythonhosted")
SILENCED = re.compile(r"#\s*(?:type: ignore|noqa|pragma: no cover|ruff: noqa|mypy: )|\bTODO\b|\bFIXME\b")


def tracked() -> list[Path]:
    """Files that belong to the project: what git would commit, or every file where there is no repository."""
    if (ROOT / ".git").exists():
        command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
        paths = [ROOT / name for name in names if name]
    else:
        paths = [path for path in ROOT.rglob("*") if not BUILT & set(path.relative_to(ROOT).parts)]
    return sorted(path for path in paths if path.is_file())


def text_of(path: Path) -> str | None:
    """The text of a file, or None when it is no text."""
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError:
        return None


def lines_with(pattern: re.Pattern[str], paths: list[Path]) -> list[str]:
    """Places where a pattern occurs, as file:line."""
    return [
        f"{path.relative_to(ROOT)}:{number}"
        for path in paths
        for number, line in enumerate((text_of(path) or "").splitlines(), start=1)
        if pattern.search(line)
    ]


def test_nothing_names_a_machine_or_a_registry() -> None:
    files = tracked()
    assert len(files) > 10
    assert lines_with(MACHINE, files) == []
    assert lines_with(HOST, files) == []


@pytest.mark.parametrize("before", [" ", "path=", "('", '"', "`"])
@pytest.mark.parametrize("folder", ["home", "root", "work", "opt", "mnt", "tmp"])
def test_a_path_of_a_machine_is_caught(before: str, folder: str) -> None:
    assert MACHINE.search(f"{before}/{folder}/x")


@pytest.mark.parametrize("path", ["docs/work/x", "../opt/x", "./tmp/x", "~/work/x", "https://example.com/home/x"])
def test_other_paths_are_let_through(path: str) -> None:
    assert not MACHINE.search(path)


@pytest.mark.parametrize("host", [("pypi", "org"), ("files", "pythonhosted", "org"), ("registry", "npmjs", "org")])
def test_a_registry_is_caught(host: tuple[str, ...]) -> None:
    assert HOST.search("https://" + ".".join(host) + "/simple")


def test_sources_are_short() -> None:
    sources = [path for path in tracked() if path.suffix == ".py" and path.is_relative_to(ROOT / "src")]
    assert sources
    assert [path.name for path in sources if len((text_of(path) or "").splitlines()) > 500] == []


def test_no_check_is_silenced_in_the_sources() -> None:
    sources = [path for path in tracked() if path.suffix == ".py" and path.is_relative_to(ROOT / "src")]
    assert lines_with(SILENCED, sources) == []


def test_no_lock_file_that_names_hosts_is_kept() -> None:
    assert [path.name for path in tracked() if path.name in {"uv.lock", "poetry.lock", "package-lock.json"}] == []


def test_every_test_file_checks_something() -> None:
    tests = [path for path in tracked() if path.name.startswith("test_") and path.suffix == ".py"]
    checks = re.compile(r"\bassert|raises|approx|check_")
    assert [path.name for path in tests if not checks.search(text_of(path) or "")] == []
