"""``covey`` and ``python -m covey``: Ctrl-C ends it quietly from the first moment on."""

import signal

from covey.cli.interrupt import leave_at_once


def run() -> None:
    """Run the command and leave the process: see `covey.cli.main.main`."""
    signal.signal(signal.SIGINT, leave_at_once)
    from covey.cli.main import main  # takes a while

    main()


if __name__ == "__main__":
    run()
