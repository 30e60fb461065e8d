"""``python -m orthoglide`` and the installed command: the command line.

Nothing is imported before the process listens to Ctrl-C: imports take longer than a finger.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from typing import Any, NoReturn

_INTERRUPTED = 130
_ERRORS = 2  # the last of the three streams that a process is given


def main() -> None:
    """Run the command line of this process; nothing written and 130 where it is interrupted."""
    while (opened := os.open(os.devnull, os.O_RDWR)) <= _ERRORS:
        pass  # a stream that was closed must not become the number of a file that is written
    os.close(opened)
    for asked in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asked, _leave)
    # Matrices are small: on several cores their parts wait for each other longer than they work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from orthoglide.cli import main as run

    try:
        run()
    except KeyboardInterrupt:  # before the command began, or after it ended
        _leave()
    except SystemExit as end:
        if end.code == _INTERRUPTED:
            # Python itself would end by the signal where an interrupt went through compiled code.
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError, AttributeError):  # full, or closed
                    stream.flush()
            os._exit(_INTERRUPTED)
        raise


def _leave(*_: Any) -> NoReturn:
    """End at once: nothing is under way that an exception could tidy up."""
    with suppress(OSError):
        os.write(_ERRORS, b"orthoglide: interrupted: nothing was written\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
