"""Datagrams of an attacker: `python fuzzer.py PORT N SEED` sends them.

Half are valid MAVLink frames of every kind of message with extreme, impossible and NaN fields, half
are random bytes, whole frames that were damaged, and cut ones. All frames speak for the autopilot.
"""

import random
import socket
import struct
import sys
import time

from pymavlink.dialects.v20 import ardupilotmega as names

EXTREMES = [0.0, -0.0, 1e38, -1e38, 1e-38, float("nan"), float("inf"), -float("inf"), 1.0]


class _Kept:
    def __init__(self):
        self.data = b""

    def write(self, data):
        self.data = bytes(data)


def field_of(kind, rng):
    """A value of a field of this type, mostly at an end of its range."""
    if kind == "char":
        return bytes(rng.choices(range(256), k=1))
    if kind in ("float", "double"):
        return rng.choice(EXTREMES)
    n_bits = 8 * struct.calcsize({"u": "B", "i": "b"}.get(kind[0], "B"))
    n_bits = int("".join(c for c in kind if c.isdigit()) or n_bits)
    low, high = (
        (0, 2**n_bits - 1) if kind[0] == "u" else (-(2 ** (n_bits - 1)), 2 ** (n_bits - 1) - 1)
    )
    return rng.choice([low, high, 0, 1, rng.randint(low, high)])


def frame_of(rng):
    """A valid frame with such fields, from the autopilot."""
    kept = _Kept()
    kind = rng.choice([*names.mavlink_map.values()])
    fields = []
    for name, kind_of in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        length = kind.array_lengths[kind.ordered_fieldnames.index(name)]
        if kind_of == "char":
            fields.append(bytes(rng.choices(range(256), k=length or 1)))
        elif length:
            fields.append([field_of(kind_of, rng) for _ in range(length)])
        else:
            fields.append(field_of(kind_of, rng))
    try:
        names.MAVLink(kept, 1, 1).send(kind(*fields))
    except (struct.error, ValueError, TypeError, OverflowError):
        names.MAVLink(kept, 1, 1).heartbeat_send(255, 255, 255, 2**32 - 1, 255)
    return kept.data


def datagrams(n, seed):
    """The datagrams, always the same for a seed."""
    rng = random.Random(seed)
    for number in range(n):
        data = frame_of(rng)
        if number % 2:
            way = rng.randrange(3)
            if way == 0:
                data = rng.randbytes(rng.randint(1, 600))
            elif way == 1:
                damaged = bytearray(data)
                damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
                data = bytes(damaged)
            else:
                data = data[: rng.randint(1, len(data))]
        yield data


def main(port, n, seed):
    place = ("127.0.0.1", int(port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for number, data in enumerate(datagrams(int(n), int(seed))):
            sender.sendto(data, place)
            if number % 20 == 19:
                time.sleep(0.01)
    print("sent", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
