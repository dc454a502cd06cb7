"""Signatures of MAVLink 2: the key of a passphrase, and what is wrong with a message that came."""

import hashlib
import time
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError, argument

# Signatures count time in units of 10 us from the start of 2015.
_BEGIN_S, _UNIT_S = 1_420_070_400, 1e-5
# By MAVLink's rules, the first message of a stream may be this old (s).
_OLDEST_S = 60.0
# What is wrong with a message. An old one may be of an autopilot whose clock is behind, and follows
# that of the messages that it gets.
UNSIGNED, OTHER_KEY, OLD = "not signed", "signed with another key", "old, or sent twice"
_VERSION_2, _IS_SIGNED = 0xFD, 1


def key_in(path: str) -> bytes:
    """The key of the passphrase in a file; raises ParameterError."""
    try:
        return hashlib.sha256(Path(path).read_text(encoding="utf-8").strip().encode()).digest()
    except (OSError, ValueError) as error:
        hint = "Give a text file with the passphrase of the ground station."
        raise ParameterError(argument("mavlink_signing"), f"{path}: {error}", hint) from None


class Signing:
    """Signs the messages of a sender with a key, and judges those that come.

    Parameters
    ----------
    mav : MAVLink
        pymavlink's sender.
    key : bytes or None
        The key; None to sign nothing, and to take every message.
    """

    def __init__(self, mav: Any, key: bytes | None) -> None:
        self._signing, self._key = mav.signing, key
        self._signing.secret_key, self._signing.sign_outgoing = key, key is not None
        # Link, system and component -> time of the last message with a right signature.
        self._times: dict[tuple[int, int, int], int] = {}
        self.tick()

    def tick(self) -> None:
        """Let the time of what is sent follow the clock; it never goes back."""
        passed = int((time.time() - _BEGIN_S) / _UNIT_S)
        self._signing.timestamp = max(self._signing.timestamp, passed)

    def flaw(self, message: Any) -> str:
        """Why a message is not to be believed; empty if it is, or if there is no key.

        A message without a right signature changes nothing here. (pymavlink's own check keeps its
        time before it looks at the signature: a single message "from the future" would silence the
        autopilot.)
        """
        if self._key is None:
            return ""
        data = bytes(message.get_msgbuf())
        if data[0] != _VERSION_2 or not data[2] & _IS_SIGNED:
            return UNSIGNED
        if hashlib.sha256(self._key + data[:-6]).digest()[:6] != data[-6:]:
            return OTHER_KEY
        at = int.from_bytes(data[-12:-6], "little")
        stream = data[-13], message.get_srcSystem(), message.get_srcComponent()
        oldest = self._signing.timestamp - int(_OLDEST_S / _UNIT_S)
        if at <= self._times.get(stream, oldest):
            return OLD
        self._times[stream] = at
        # A computer without a clock takes the time of its autopilot.
        self._signing.timestamp = max(self._signing.timestamp, at)
        return ""
