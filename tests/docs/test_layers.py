"""The layers are those of docs/architecture.md, and the linter sees a module that breaks them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run import-linter on the copy of the project in `folder`."""
    program = "import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())"
    program = f"import sys; sys.path.insert(0, 'src'); {program}"
    command = [sys.executable, "-c", program, "--no-cache"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_layers_hold(copy: Path) -> None:
    finished = lint(copy)
    assert finished.returncode == 0, finished.stdout + finished.stderr


@pytest.mark.parametrize(
    ("module", "statement"),
    [
        ("errors.py", "import covey.geometry"),
        ("geometry/polygon.py", "from covey.environment import Landmarks"),
        ("coverage/__init__.py", "import covey.optimize"),
        ("mission/__init__.py", "import covey.optimize"),
        ("optimize/__init__.py", "import covey.runtime"),
        ("runtime/__init__.py", "def f():\n    import covey.cli"),
        ("protocol/__init__.py", "import covey.transports"),
        ("protocol/__init__.py", "import time"),
        ("protocol/__init__.py", "from random import random"),
        ("protocol/__init__.py", "from threading import Thread"),
    ],
)
def test_a_module_that_breaks_them_is_seen(copy: Path, module: str, statement: str) -> None:
    path = copy / "src" / "covey" / module
    path.write_text(path.read_text("utf-8") + "\n" + statement + "\n", "utf-8")
    finished = lint(copy)
    assert finished.returncode == 1, finished.stdout + finished.stderr
    assert "BROKEN" in finished.stdout


def test_every_package_has_its_layer_and_the_page_names_it() -> None:
    layers = PROJECT["tool"]["importlinter"]["contracts"][0]["layers"]
    names = {name.strip().removeprefix("covey.") for layer in layers for name in layer.split("|")}
    source = ROOT / "src" / "covey"
    packages = {path.parent.name for path in source.glob("*/__init__.py")}
    files = {path.stem for path in source.glob("*.py")} - {"__init__", "__main__"}
    assert packages | files <= names
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    drawn = page.partition("## Layers")[2].partition("\n## ")[0]
    assert [name for name in sorted(names) if not re.search(rf"\b{name}\b", drawn)] == []
