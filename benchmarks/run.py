"""Run the benchmarks and print one JSON document.

Each other module in this folder is a benchmark: it offers ``run(quick: bool) -> dict`` with plain numbers, seconds
where a key ends in ``_s``.  Times belong to one machine and one run: compare them within a document, not across.

    python benchmarks/run.py [--quick] [NAME ...]
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
LIBRARIES = ("covey", "numba", "numpy", "scipy")


def names() -> list[str]:
    """Names of the benchmarks."""
    files = (path.stem for path in FOLDER.glob("*.py"))
    return sorted(name for name in files if name != "run" and not name.startswith("_"))


def main() -> int:
    """Parse the command line, run what it names, print the document."""
    parser = argparse.ArgumentParser(description="Run benchmarks and print them as JSON.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names())}; all by default")
    parser.add_argument("--quick", action="store_true", help="fewer seeds and repetitions")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(names()))
    if unknown:
        parser.error(f"no benchmark is called {', '.join(unknown)}; there are {', '.join(names())}")

    results: dict[str, Any] = {}
    for name in arguments.names or names():
        print(f"{name} ...", end="", file=sys.stderr, flush=True)
        started = time.perf_counter()
        results[name] = importlib.import_module(name).run(quick=arguments.quick)
        print(f" {time.perf_counter() - started:.1f} s", file=sys.stderr)
    document = {
        "quick": arguments.quick,
        "machine": {"cpus": os.cpu_count(), "system": platform.system(), "architecture": platform.machine()},
        "software": {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}},
        "benchmarks": results,
    }
    print(json.dumps(document, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
