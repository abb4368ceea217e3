"""Reads TensorBoard's event files, of which the package that writes them reads none."""

import struct
from importlib import import_module
from pathlib import Path


def scalars(folder: Path) -> list[tuple[str, int, float]]:
    """Tag, step and value of the scalars in a folder's event files, in the order in which they were
    written."""
    event_of = import_module("tensorboardX.proto.event_pb2").Event.FromString
    found = []
    for path in folder.iterdir():
        content = path.read_bytes()
        while len(content) >= 16:  # what is being written may end in the middle
            # Length and its checksum, the event and its checksum.
            (length,) = struct.unpack("<Q", content[:8])
            event = event_of(content[12 : 12 + length])
            found += [
                (value.tag, event.step, value.simple_value)
                for value in event.summary.value
                if value.HasField("simple_value")
            ]
            content = content[16 + length :]
    return found
