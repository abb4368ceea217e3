"""What reading a stranger's file may take: the limits by kind of file, which its readers check.

Every limit is checked before that much is allocated, by size where a file says it and by counting
where it does not, so that a file that would fill the memory is refused within seconds. What they
come to together is tried by `tests/files/test_hostile_files.py`, which has a file for each of them.
"""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass

MB = 1_000_000
_ENTRY = b"PK\x01\x02"
"""What each entry of a zip file's directory begins with."""


@dataclass(frozen=True)
class Budget:
    """The limits of a kind of file, by what is counted."""

    kind: str
    """What such a file is, for errors and the documentation."""
    limits: Mapping[str, int]
    growth: float = 200
    """By how much packed data may grow where they exceed `free`; logs of numbers grow 3 to 20 times
    and a bomb up to 1,000 times and more."""
    free: int = 64 * MB
    """Bytes that packed data may have unpacked whatever they had before."""

    def check(self, counted: str, count: float) -> None:
        """Checks a count.

        Raises:
            ValueError: it exceeds the limit.
        """
        limit = self.limits[counted]
        if count > limit:
            many = f"{count / MB:.0f} MB" if counted == "bytes" else f"{count:.0f} {counted}"
            most = f"{limit / MB:g} MB" if counted == "bytes" else f"{limit}"
            raise ValueError(f"{many} or more; {self.kind} has {most} at most")

    def allow(self, raw: bytes) -> bytes:
        """Returns bytes that are not too many.

        Raises:
            ValueError: they are.
        """
        self.check("bytes", len(raw))
        return raw

    def check_growth(self, packed: int, plain: int) -> None:
        """Checks how much packed data grows, before it does or while it does.

        Args:
            packed: bytes of the file.
            plain: bytes of what it holds.

        Raises:
            ValueError: more than such a file does.
        """
        if plain > min(max(self.free, self.growth * packed), self.limits["bytes"]):
            raise ValueError(
                f"{packed / MB:.1f} MB that unpack to {plain / MB:.0f} MB or more, as no "
                f"{self.kind.removeprefix('a ')} does"
            )

    def open_zip(self, raw: bytes) -> zipfile.ZipFile:
        """Opens the bytes of a zip file, whose entries together keep the limits.

        Raises:
            ValueError, zipfile.BadZipFile: they do not, or it is none.
        """
        self.check("bytes", len(raw))
        # Each entry costs half a kilobyte as soon as the file is opened.
        self.check("entries", raw.count(_ENTRY))
        file = zipfile.ZipFile(io.BytesIO(raw))
        self.check_growth(len(raw), sum(entry.file_size for entry in file.infolist()))
        return file


TOML = Budget("a TOML file", {"bytes": 2 * MB, "names in a dotted key": 64})
"""Drones, studies, settings of a folder, maps of columns, plans; Python reads 1 MB a second."""
JSON = Budget("a JSON file", {"bytes": 16 * MB})
"""Policies, `run.json` and what a study notes; a byte may become twenty in memory."""
TABLE = Budget("a table of a run", {"bytes": 64 * MB, "columns": 1000})
"""CSV tables that commands write and the report shows, and timed way-points."""
COMMENTS = Budget("the comments of a file", {"bytes": MB})
"""The lines with `#` above a table, its record among them."""
LOG = Budget("a log", {"bytes": 4000 * MB, "bytes a line": MB, "columns": 4000, "rows": 10 * MB})
"""Flight logs of all formats, unpacked; tables are read in parts of 8 MB or 60,000 rows."""
WHOLE_LOG = Budget("a log that is read at once", {"bytes": 256 * MB, "fields": 1000})
"""Of a Crazyflie's card, ULog, DataFlash and blackbox; and our own logs beside a report."""
DEFINITIONS = Budget("the definitions of a recording's messages", {"bytes": 2 * MB})
"""In MCAP and SQLite recordings; what follows of them becomes code of `rosbags`."""
MESSAGE = Budget("a compressed message of a recording", {"bytes": 16 * MB})
"""In MCAP and SQLite recordings, which hold messages that are packed one by one."""
NETWORK = Budget("a network's file", {"bytes": 64 * MB, "entries": 2000, "numbers": 8 * MB})
"""Zip files of tensors: `model.zip` of Stable-Baselines3 and our checkpoints."""
PICKLE = Budget("a pickle", {"bytes": 16 * MB, "instructions": 10_000})
"""Parts of `model.zip`, and `vecnormalize.pkl`; see `integrations.policies.pickled`."""
STUDY = Budget("a study", {"tasks": 200_000})
"""What the tables of a study's TOML file stand for."""
