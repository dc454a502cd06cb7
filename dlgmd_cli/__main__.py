"""`python -m dlgmd_cli`, and all that the command `dlgmd` imports before it heeds signals."""

try:
    import os
    import signal
    import sys
    from contextlib import suppress

    from dlgmd_cli.stops import answer
except KeyboardInterrupt:
    raise SystemExit(130) from None


def main() -> None:
    """Entry point of the `dlgmd` command."""
    # While modules are imported nothing is made that could be lost, and an exception may be shown
    # or swallowed by whatever it comes across.
    answer(lambda *_: os._exit(130))
    from dlgmd_cli.app import main as run

    try:
        run()
    except SystemExit as ending:
        # All is said and done; what is left of Python's end would only show a traceback.
        answer(signal.SIG_IGN)
        _end(ending.code)
        raise


def _end(code: object) -> None:
    """End at once if a thread still runs, which Python's own end could make crash."""
    threading = sys.modules.get("threading")
    if threading is None or threading.active_count() == 1:
        return
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # nobody reads it
            if stream is not None:
                stream.flush()
    os._exit(code if isinstance(code, int) else 1)


if __name__ == "__main__":
    main()
