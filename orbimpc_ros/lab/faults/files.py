"""Rows on files: damaged bags and malformed YAML, read by the tool's own readers."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message

from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.outcome import Outcome, Trial
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.messages import Frames, Stamp, twist_message
from orbimpc_ros.tool.io import bag, document
from orbimpc_ros.tool.io.bag.writer import BagWriter, Topic
from orbimpc_ros.tool.io.share import config

BAGS, DOCUMENTS = (20, 400), (10, 100)  # short, long
MESSAGES = 50
DEEP = 5000
Damage = Callable[[bytes, random.Random], bytes]


def _bit_flipped(data: bytes, draw: random.Random) -> bytes:
    place, bit = draw.randrange(len(data)), 1 << draw.randrange(8)
    return data[:place] + bytes([data[place] ^ bit]) + data[place + 1 :]


def _cut_off(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data))]


def _overwritten(data: bytes, draw: random.Random) -> bytes:
    place = draw.randrange(len(data))
    return data[:place] + draw.randbytes(64) + data[place + 64 :]


def _noise(data: bytes, draw: random.Random) -> bytes:
    return draw.randbytes(draw.randrange(len(data)))


def _nested(_data: bytes, draw: random.Random) -> bytes:
    return draw.choice((b'[', b'{a: ', b'- ')) * DEEP


def _tagged(data: bytes, draw: random.Random) -> bytes:
    tag = draw.choice((b'!!python/object/apply:os.getcwd []', b'!!python/name:os.system', b'*none'))
    return b'a: ' + tag + b'\n' + data


BINARY: tuple[Damage, ...] = (_bit_flipped, _cut_off, _overwritten, _noise)
TEXT: tuple[Damage, ...] = (_overwritten, _noise, _nested, _tagged)


def _bags(lab: Lab, long: bool) -> Iterator[Outcome]:
    folder, _ = lab.place()
    whole = _written(folder / 'whole')
    for number in range(BAGS[long]):
        draw = random.Random(number)
        file = folder / 'damaged.mcap'
        damage = BINARY[number % len(BINARY)]
        file.write_bytes(damage(whole.read_bytes(), draw))
        yield _read(_named(damage, number), partial(_through, file))


def _through(file: Path) -> None:
    with redirect_stderr(StringIO()):  # that a bag was cut off is told there
        for _ in bag.read(file):
            pass


def _named(damage: Damage, number: int) -> str:
    return f'{damage.__name__.strip("_")} {number}'


def _written(folder: Path) -> Path:
    """Return the MCAP file of a small bag."""
    with BagWriter(folder, [Topic('/cmd_vel', 'geometry_msgs/msg/TwistStamped')], {}) as writer:
        for count in range(MESSAGES):
            writer.write('/cmd_vel', count, _serialised(count))
    return folder / f'{folder.name}.mcap'


def _serialised(count: int) -> bytes:

    stamp = Stamp(count * 10**8, Frames('odom', 'base_link'))
    return bytes(serialize_message(twist_message(stamp, 0.5, np.array([0.1]))))


def _documents(lab: Lab, long: bool) -> Iterator[Outcome]:
    folder, _ = lab.place()
    whole = config('retrieval.yaml').read_bytes()
    for number in range(DOCUMENTS[long]):
        draw = random.Random(number)
        file = folder / 'malformed.yaml'
        damage = TEXT[number % len(TEXT)]
        file.write_bytes(damage(whole, draw))
        yield _read(_named(damage, number), partial(document.read, str(file)))


def _read(case: str, reader: Callable[[], object]) -> Outcome:
    """Read something damaged: it is refused in one line, or what is left of it is whole."""
    try:
        reader()
    except BadInput as error:
        return Outcome(case, failure='' if '\n' not in str(error) else 'more than a line')
    except Exception as error:  # that is what is looked for
        return Outcome(case, failure=f'{type(error).__name__}: {error}')
    return Outcome(case)


TRIALS = (
    Trial('bags', 'damaged bags: refused in one line', 0.0, _bags),
    Trial('yaml', 'malformed YAML: refused in one line', 0.0, _documents),
)
