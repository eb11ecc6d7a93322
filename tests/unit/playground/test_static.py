"""The built page that comes with covey is that of its sources; `make web` builds it."""

import hashlib
import json
from pathlib import Path

import pytest

from covey.playground import server, typescript

WEB = server.STATIC.with_name("web")


def digests(folder: Path, *, without: str = "") -> dict[str, str]:
    """The SHA-256 of each file, by its path."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "node_modules" not in path.parts and path.name != without
    }


@pytest.mark.parametrize(("folder", "part"), [(WEB, "sources"), (server.STATIC, "built")])
def test_the_page_is_built_from_these_sources(folder: Path, part: str) -> None:
    recorded = json.loads((server.STATIC / "build.json").read_text())
    assert recorded[part] == digests(folder, without="build.json"), (
        "run make web and commit src/covey/playground/static"
    )


def test_the_page_knows_the_messages_as_they_are() -> None:
    assert (WEB / "src" / "messages.ts").read_text() == typescript.source(), "run make web"


def test_packages_are_pinned_and_no_file_names_a_registry() -> None:
    pinned = json.loads((WEB / "package.json").read_text())
    assert all(version[0].isdigit() for version in pinned["devDependencies"].values())
    assert not (WEB / "package-lock.json").exists()


def test_the_page_asks_nobody_else_for_anything() -> None:
    for name in ("index.html", "style.css", "app.js"):
        text = (server.STATIC / name).read_text().replace("http://www.w3.org/", "")
        assert "http://" not in text
        assert "https://" not in text
        assert "@import" not in text


def test_no_source_of_the_page_is_longer_than_500_lines() -> None:
    for path in WEB.rglob("*"):
        if path.suffix in (".ts", ".css", ".mjs") and "node_modules" not in path.parts:
            assert len(path.read_text().splitlines()) <= 500, path
