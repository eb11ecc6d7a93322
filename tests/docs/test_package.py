"""The public face of the package: what it exports, what its docstrings point to, and how it is built."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import covey

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
HEAVY = {"matplotlib", "numba", "pydantic", "pyproj", "ruamel", "scipy", "shapely"}


def modules() -> Iterator[ModuleType]:
    yield covey
    for found in pkgutil.walk_packages(covey.__path__, "covey."):
        if not found.name.endswith("__main__"):
            yield importlib.import_module(found.name)


MODULES = list(modules())
EXPORTING = [module for module in MODULES if hasattr(module, "__all__")]


def constants_classes_functions(name: str) -> tuple[int, str]:
    """Sort key: constants, then classes, then functions, each in the order of the alphabet."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2), name


@pytest.mark.parametrize("module", EXPORTING, ids=lambda module: module.__name__)
def test_exported_names_are_sorted_and_exist(module: ModuleType) -> None:
    assert list(module.__all__) == sorted(set(module.__all__), key=constants_classes_functions)
    for name in module.__all__:
        assert getattr(module, name) is not None
    assert set(module.__all__) <= set(dir(module))


@pytest.mark.parametrize("module", EXPORTING, ids=lambda module: module.__name__)
def test_exported_names_are_documented(module: ModuleType) -> None:
    public = {name: getattr(module, name) for name in module.__all__}
    written = {name: item for name, item in public.items() if inspect.isclass(item) or inspect.isroutine(item)}
    assert [name for name, item in written.items() if not inspect.getdoc(item)] == []


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_modules_are_documented(module: ModuleType) -> None:
    assert module.__doc__
    assert len(module.__doc__) > 10


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError):
        getattr(covey, "no_such" + "_name")


def test_version_is_the_projects() -> None:
    assert covey.__version__ == PROJECT["project"]["version"]


HELP = """
import sys
from covey.cli.main import main
sys.argv = ["covey", "--help"]
try:
    main()
except SystemExit:
    pass
"""


@pytest.mark.parametrize("program", ["import covey", HELP], ids=["import", "help"])
def test_nothing_heavy_is_imported_before_it_is_used(program: str) -> None:
    program += "\nimport sys; print('loaded', *sorted({name.partition('.')[0] for name in sys.modules}))"
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    loaded = set(shown.splitlines()[-1].split()[1:])
    assert "covey" in loaded
    assert loaded & HEAVY == set()


def test_requirements_are_pinned_and_hashed() -> None:
    text = (ROOT / "requirements" / "dev.txt").read_text("utf-8")
    pins = dict.fromkeys(re.findall(r"^([a-z0-9-]+)==\S+.* \\$", text, re.MULTILINE))
    named = [re.split(r"[>=<]", name)[0].replace(".", "-") for name in PROJECT["project"]["dependencies"]]
    tools = (ROOT / "requirements" / "dev.in").read_text("utf-8").splitlines()
    assert {*named, *(tool for tool in tools if tool and not tool.startswith("#"))} <= set(pins)
    for entry in re.split(r"\n(?=[a-z])", text.strip()):
        assert "--hash=sha256:" in entry, entry.splitlines()[0]


def test_each_deviation_that_the_source_names_has_its_row() -> None:
    rows = set(re.findall(r"^\| ([A-Z]\d+) \|", (ROOT / "docs" / "deviations.md").read_text("utf-8"), re.MULTILINE))
    named: set[str] = set()
    for path in sorted((ROOT / "src").rglob("*.py")):
        for listed in re.findall(r"[Dd]eviations?:? ((?:[A-Z]\d+(?:, | and |/)?)+)", path.read_text("utf-8")):
            named |= set(re.findall(r"[A-Z]\d+", listed))
    assert named
    assert named <= rows
