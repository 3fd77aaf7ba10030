# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Writing a bag as rosbag2 has them: a folder of metadata.yaml and an MCAP file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from orbimpc_ros.tool.io.bag import mcap
from orbimpc_ros.tool.io.bag.raw import store
from orbimpc_ros.tool.io.topics import Topic

METADATA_VERSION = 9
CHUNK = 1 << 16  # [bytes]: what a recorder that is killed may lose
FOREVER = {'sec': 9223372036, 'nsec': 854775807}


class BagWriter:
    """Writes a new bag; closed, it is one that ``ros2 bag`` reads.

    Args:
        folder: created; the MCAP file in it has its name.
        topics: of the bag; all are listed, also those on which nothing comes.
        notes: kept in the metadata, by name.
    """

    def __init__(self, folder: Path, topics: Sequence[Topic], notes: Mapping[str, str]) -> None:
        folder.mkdir(parents=True)
        self.folder, self._topics, self._notes = folder, topics, dict(notes)
        self._counts = dict.fromkeys((topic.name for topic in topics), 0)
        self._first, self._last = 0, 0
        self._store = store()
        self._stream = (folder / f'{folder.name}.mcap').open('wb')
        self._writer = McapWriter(
            self._stream, CHUNK, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._writer.start(profile='ros2', library='orbimpc_ros')
        # Also here: the metadata of a bag are written only when it is closed.
        self._writer.add_metadata(mcap.NOTES, self._notes)
        self._channels = {topic.name: self._channel(topic) for topic in topics}

    def _channel(self, topic: Topic) -> int:
        text, _ = self._store.generate_msgdef(topic.type, ros_version=2)
        schema = self._writer.register_schema(topic.type, 'ros2msg', text.encode())
        return self._writer.register_channel(
            topic.name,
            'cdr',
            schema,
            {
                'offered_qos_profiles': yaml.safe_dump([_qos(topic)]),
                'topic_type_hash': self._store.hash_rihs01(topic.type),
            },
        )

    def write(self, topic: str, stamp: int, data: bytes, sent: int | None = None) -> None:
        """Append a serialised message.

        Args:
            topic: it came on.
            stamp: to record it under [ns].
            data: in CDR.
            sent: when it was sent [ns], if that is known.
        """
        if not sum(self._counts.values()):
            self._first = self._last = stamp
        self._first, self._last = min(self._first, stamp), max(self._last, stamp)
        self._counts[topic] += 1
        self._writer.add_message(
            self._channels[topic],
            stamp,
            data,
            stamp if sent is None else sent,
            self._counts[topic],
        )
        self._stream.flush()  # complete chunks outlive the recorder, however it ends

    def close(self) -> None:
        """Write the index and the metadata; a second call does nothing."""
        if self._stream.closed:
            return
        self._writer.finish()
        self._stream.close()
        text = yaml.safe_dump({'rosbag2_bagfile_information': self._metadata()}, sort_keys=False)
        (self.folder / 'metadata.yaml').write_text(text)

    def _metadata(self) -> dict[str, Any]:
        file = f'{self.folder.name}.mcap'
        span = {
            'starting_time': {'nanoseconds_since_epoch': self._first},
            'duration': {'nanoseconds': self._last - self._first},
            'message_count': sum(self._counts.values()),
        }
        return {
            'version': METADATA_VERSION,
            'storage_identifier': 'mcap',
            **{name: dict(v) if isinstance(v, dict) else v for name, v in span.items()},
            'topics_with_message_count': [self._topic_metadata(topic) for topic in self._topics],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [file],
            'files': [{'path': file, **span}],
            'custom_data': self._notes or None,
            'ros_distro': 'jazzy',
        }

    def _topic_metadata(self, topic: Topic) -> dict[str, Any]:
        return {
            'topic_metadata': {
                'name': topic.name,
                'type': topic.type,
                'serialization_format': 'cdr',
                'offered_qos_profiles': [_qos(topic)],
                'type_description_hash': self._store.hash_rihs01(topic.type),
            },
            'message_count': self._counts[topic.name],
        }

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _qos(topic: Topic) -> dict[str, Any]:
    """Return the profile of the interface: reliable, depth 1; a player publishes with it."""
    return {
        'history': 'keep_last',
        'depth': 1,
        'reliability': 'reliable',
        'durability': 'transient_local' if topic.latched else 'volatile',
        'deadline': dict(FOREVER),
        'lifespan': dict(FOREVER),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(FOREVER),
        'avoid_ros_namespace_conventions': False,
    }
