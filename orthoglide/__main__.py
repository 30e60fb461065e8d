"""``python -m orthoglide`` and the installed command: the command line.

Nothing is imported before the process listens to Ctrl-C: imports take longer than a finger.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any, NoReturn

_INTERRUPTED = 130


def main() -> None:
    """Run the command line of this process; nothing written and 130 where it is interrupted."""
    for asked in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asked, _leave)
    from orthoglide.cli import main as run

    try:
        run()
    except KeyboardInterrupt:  # before the command began, or after it ended
        _leave()
    except SystemExit as end:
        if end.code == _INTERRUPTED:
            # Python itself would end by the signal where an interrupt went through compiled code.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(_INTERRUPTED)
        raise


def _leave(*_: Any) -> NoReturn:
    """End at once: nothing is under way that an exception could tidy up."""
    os.write(2, b"orthoglide: interrupted: nothing was written\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
