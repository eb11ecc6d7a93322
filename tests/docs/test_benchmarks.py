"""The benchmarks can be run and print JSON; what they measure is not judged here."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
MODULES = sorted(path for path in FOLDER.glob("*.py") if path.stem != "run" and not path.stem.startswith("_"))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_each_benchmark_says_what_it_measures_and_can_be_run(path: Path) -> None:
    tree = ast.parse(path.read_text("utf-8"))
    assert ast.get_docstring(tree)
    runs = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "run"]
    assert [argument.arg for argument in runs[0].args.args + runs[0].args.kwonlyargs] == ["quick"]


def test_one_benchmark_prints_one_document() -> None:
    command = [sys.executable, "-W", "error", str(FOLDER / "run.py"), "--quick", "startup"]
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    document = json.loads(finished.stdout)
    assert document["quick"] is True
    assert set(document["benchmarks"]["startup"]) == {"interpreter_s", "import_covey_s", "covey_help_s"}
    assert all(seconds > 0.0 for seconds in document["benchmarks"]["startup"].values())


def test_an_unknown_benchmark_is_named() -> None:
    finished = subprocess.run(
        [sys.executable, str(FOLDER / "run.py"), "no-such"], capture_output=True, text=True, check=False
    )
    assert finished.returncode == 2
    assert "no benchmark is called no-such" in finished.stderr
