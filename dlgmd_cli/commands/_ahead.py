"""Importing in the background what a command will need, while it waits for a decoder."""

import threading
from collections.abc import Iterable
from contextlib import suppress
from importlib import import_module


def import_ahead(modules: Iterable[str]) -> None:
    """Import `modules` in a thread of its own; what cannot be imported is left to its user."""

    def load() -> None:
        for name in modules:
            with suppress(Exception):
                import_module(name)

    threading.Thread(target=load, name="dlgmd-import", daemon=True).start()
