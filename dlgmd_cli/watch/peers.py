"""Who speaks on a link: the senders that were heard, and which of them is the autopilot."""

import math
import time
from collections import deque
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.watch.links import Address

# An address is answered for 5 s after its last message; at most 32 addresses are known at once.
_PLACE_S, _MAX_PLACES = 5.0, 32
# Two links of one autopilot report the same time of its start, within the delay of a link (s).
_SAME_START_S = 1.0
# So many messages with a clock say when an autopilot was started: after a restart, about 2 s.
_N_STARTS = 60
# What several addresses that speak as the autopilot are.
LINKS, AUTOPILOTS, UNKNOWN = "links of one autopilot", "several autopilots", "unknown"


@dataclass(eq=False)
class Peer:
    """A sender: its parser, and what it sent.

    Attributes
    ----------
    heard_s, pilot_s : float
        Arrival time of its last message, and of its last one as the autopilot.
    starts_s : deque of float
        When the autopilot was started, by each of its last messages with a clock.
    """

    place: Address
    parser: Any
    heard_s: float = -math.inf
    pilot_s: float = -math.inf
    starts_s: deque[float] = field(default_factory=lambda: deque(maxlen=_N_STARTS))

    @property
    def name(self) -> str:
        """Its address as HOST:PORT."""
        return ":".join(map(str, self.place[:2])) or "the other end"


class Peers:
    """The senders of a link. The first that is heard with the vehicle's heartbeat is the autopilot.

    It stays the autopilot until it has been silent for 5 s; who else speaks as the autopilot is
    only noted.

    Parameters
    ----------
    names : module
        The messages of MAVLink.
    """

    def __init__(self, names: ModuleType) -> None:
        self._names, self._peers = names, dict[Address, Peer]()
        self._owner: Peer | None = None

    def of(self, place: Address) -> Peer:
        """The sender at an address, which may be new."""
        if place not in self._peers:
            if len(self._peers) >= _MAX_PLACES:
                others = [one for one in self._peers.values() if one is not self._owner]
                del self._peers[min(others, key=lambda one: one.heard_s).place]
            self._peers[place] = Peer(place, self._names.MAVLink(None))
            self._peers[place].parser.robust_parsing = True
        return self._peers[place]

    def heard(self) -> list[Address]:
        """The addresses that sent something within the last 5 s."""
        from_s = time.monotonic() - _PLACE_S
        return [place for place, peer in self._peers.items() if peer.heard_s >= from_s]

    def take(self, peer: Peer, message: Any, *, is_beat: bool) -> bool:
        """Note a message that speaks as the autopilot; whether it counts."""
        now_s, has_owner = time.monotonic(), bool(self.speakers())
        if is_beat and not has_owner:
            self._owner = peer
        if (boot_ms := getattr(message, "time_boot_ms", None)) is not None:
            peer.starts_s.append(now_s - 1e-3 * boot_ms)
        if is_beat or peer.pilot_s > -math.inf:
            peer.pilot_s = now_s
        return not has_owner or peer is self._owner

    def speakers(self) -> list[Peer]:
        """Who sent as the autopilot within the last 5 s; the one that is answered, first."""
        from_s, owner = time.monotonic() - _PLACE_S, self._owner
        if owner is None or owner.pilot_s < from_s:
            return []
        others = [one for one in self._peers.values() if one.pilot_s >= from_s and one is not owner]
        return [owner, *others]

    def kinship(self) -> str:
        """What the speakers are, by the time at which each says it was started."""
        # A message that waited on its way seems to be of a later start.
        started_s = [min(peer.starts_s, default=math.nan) for peer in self.speakers()]
        apart_s = [abs(one - started_s[0]) for one in started_s[1:]]
        if any(one > _SAME_START_S for one in apart_s):
            return AUTOPILOTS
        return UNKNOWN if any(map(math.isnan, apart_s)) else LINKS

    def facts(self) -> dict[str, Json]:
        """The entries of an event, if several addresses speak as the autopilot."""
        speakers = self.speakers()
        if len(speakers) < 2:
            return {}
        return {"addresses": [one.name for one in speakers], "are": self.kinship()}
