"""The way to a Dask scheduler, by its address or its scheduler file."""

import json
import logging
import re
import warnings
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import MissingExtraError, ParameterError, WorkerError

# How long it may take to answer.
CONNECT_S = 10.0
_LOGGERS = ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio")
_ADDRESS = re.compile(r"((tcp|tls|ws|wss|ucx)://)?[^\s/:]+:[0-9]{1,5}|[a-z]+://\[[^\s/]+\]:[0-9]+")
_WHAT = "--scheduler"


def connect(scheduler: str, *, quiet: bool = False) -> Any:
    """A Dask client of a scheduler, by its address or scheduler file; raises as `work_on`."""
    address = _address(scheduler)
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError(
            _WHAT,
            "it needs the package 'distributed'",
            "Install it with: pip install 'dlgmd[cluster]'.",
        ) from None
    if quiet:
        _hush()
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError:
        raise WorkerError(
            scheduler,
            f"no Dask scheduler answers within {CONNECT_S:g} s",
            "Start it with 'dask scheduler', or check --scheduler.",
        ) from None
    except Exception as error:
        why = str(error).split("\n")[0] or type(error).__name__
        raise WorkerError(scheduler, f"no connection ({why})", "Check --scheduler.") from None


def _hush() -> None:
    """Silence what Dask, whose import has set its loggers up, has to say."""
    for name in _LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    warnings.filterwarnings("ignore", module="distributed")


def _address(scheduler: str) -> str:
    """The address that a user means."""
    path = Path(scheduler)
    if not path.is_file() and not scheduler.endswith(".json"):
        if _ADDRESS.fullmatch(scheduler):
            return scheduler
        raise ParameterError(
            _WHAT,
            f"{scheduler!r} is neither an address nor a scheduler file",
            "Give one like tcp://HOST:8786, or the name of the file.",
        )
    try:
        address = json.loads(path.read_bytes())["address"]
    except OSError as error:
        why = f"it cannot be read ({error.strerror})"
    except (ValueError, KeyError, TypeError):
        why = "it is no scheduler file"
    else:
        if isinstance(address, str) and _ADDRESS.fullmatch(address):
            return address
        why = "it holds no address"
    mend = "Write it with: dask scheduler --scheduler-file FILE."
    raise WorkerError(scheduler, why, mend)
