"""MCAP files as the library rosbags gives other bags: topics first, then messages, in the order of the file.

The library mcap also reads files of ROS 1 messages, and those without an index.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polhode.runtime.errors import InputError

ENCODINGS = ("cdr", "ros1")
"""Of messages that are read: those of ROS 2 and of ROS 1"""


@dataclass(frozen=True)
class McapTopic:
    """A topic with its messages' type, as rosbags describes it."""

    topic: str
    msgtype: str
    msgcount: int


class McapReader:
    """Files of one recording."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths, self._stack = paths, ExitStack()
        self._readers: list[Any] = []
        self.connections: list[McapTopic] = []
        self.is_ros1 = False

    def open(self) -> None:
        """Read the topics. Raises InputError for messages of other encodings; what the library raises."""
        from mcap.reader import make_reader

        self._readers = [make_reader(self._stack.enter_context(path.open("rb"))) for path in self._paths]
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        encodings: set[str] = set()
        for reader in self._readers:
            summary = reader.get_summary()
            if summary is not None and summary.statistics is not None and summary.channels:
                schemas = summary.schemas
                found = [
                    (
                        channel,
                        schemas.get(channel.schema_id),
                        summary.statistics.channel_message_counts.get(k, 0),
                    )
                    for k, channel in summary.channels.items()
                ]
            else:
                found = [(channel, schema, 1) for schema, channel, _ in reader.iter_messages()]
            for channel, schema, count in found:
                encodings.add(channel.message_encoding)
                if schema is None or channel.message_encoding not in ENCODINGS:
                    continue
                self.is_ros1 = channel.message_encoding == "ros1"
                package, _, name = schema.name.partition("/")
                types[channel.topic] = f"{package}/msg/{name.rpartition('/')[2]}"
                counts[channel.topic] += count
        if encodings and not types:
            raise InputError(
                f"{self._paths[0]}: an MCAP of {', '.join(sorted(encodings)) or 'unnamed'} messages; only "
                "those of ROS (cdr, ros1) are read: convert it, or export the images"
            )
        self.connections = [McapTopic(topic, types[topic], counts[topic]) for topic in types]

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    def messages(self, connections: Sequence[McapTopic]) -> Iterator[tuple[McapTopic, int, bytes]]:
        """Topic, time of recording [ns] and content of each message, in the order of the files."""
        chosen = {each.topic: each for each in connections}
        for reader in self._readers:
            for _, channel, message in reader.iter_messages(topics=list(chosen), log_time_order=False):
                yield chosen[channel.topic], message.log_time, message.data
