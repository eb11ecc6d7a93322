"""How long a process takes to import covey, and to show its help: medians, with a bare interpreter to compare."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

PROGRAMS = {
    "interpreter": "pass",
    "import_covey": "import covey",
    "covey_help": "import sys; sys.argv = ['covey', '--help']; from covey.cli.main import main; main()",
}


def seconds(program: str) -> float:
    """Wall-clock time of one process."""
    started = time.perf_counter()
    subprocess.run([sys.executable, "-c", program], stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - started


def run(quick: bool) -> dict[str, float]:
    """Median seconds of each program, after one run that fills the caches."""
    repetitions = 5 if quick else 15
    result: dict[str, float] = {}
    for name, program in PROGRAMS.items():
        seconds(program)
        result[f"{name}_s"] = round(statistics.median(seconds(program) for _ in range(repetitions)), 4)
    return result
