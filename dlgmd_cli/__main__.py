"""`python -m dlgmd_cli` and the command `dlgmd`."""

import os
import sys


def main() -> None:
    """Entry point of the `dlgmd` command."""
    try:  # starts before any other import: until then, Ctrl-C prints a traceback
        from dlgmd_cli.machine import cancel

        cancel.listen()
    except KeyboardInterrupt:
        os._exit(130)
    from contextlib import suppress

    from dlgmd_cli.commands.app import main as run

    try:
        run()
    except SystemExit as ending:
        cancel.ignore()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, AttributeError):  # a closed stream or pipe
                stream.flush()
        # Python's normal exit takes a second on a busy machine, and waits for a hanging decoder.
        os._exit(ending.code if isinstance(ending.code, int) else 1)


if __name__ == "__main__":
    main()
