"""Files as somebody would make them to fill a reader's memory, to keep it busy, or to run code.

`python tests/common/hostile_files.py FOLDER` writes all of them; each is small, and made within a
second.
"""

import base64
import gzip
import io
import json
import sqlite3
import sys
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import polars

MB = 1_000_000
ZEROS = bytes(MB)
SOUND = Path(__file__).parents[1] / "integrations" / "policies" / "stable_baselines" / "ppo.zip"
"""A policy of Stable-Baselines3, of which others are changed."""
HEADER = b"time,x,y,z,motor_1,motor_2,motor_3,motor_4\n"


def packed(blocks: int, block: bytes, head: bytes = b"") -> bytes:
    """A gzip file of a block that is repeated."""
    content = io.BytesIO()
    with gzip.GzipFile(fileobj=content, mode="wb", compresslevel=1, mtime=0) as file:
        file.write(head)
        for _ in range(blocks):
            file.write(block)
    return content.getvalue()


def gzip_bomb() -> bytes:
    """4 GB of zeros below a header."""
    return packed(1, ZEROS * 300, HEADER)


def endless_line() -> bytes:
    """A line of 60 MB, which stays below what any packed file may have."""
    return packed(60, b"1" * MB, HEADER)


def many_columns() -> bytes:
    """A million columns."""
    return (
        b",".join(b"%d" % number for number in range(1_000_000)) + b"\n" + b"1," * 999_999 + b"1\n"
    )


def parquet_of(frame: polars.DataFrame) -> bytes:
    """A Parquet file."""
    content = io.BytesIO()
    frame.write_parquet(content, compression="zstd")
    return content.getvalue()


def parquet_rows() -> bytes:
    """Nine million rows of eight columns in a few kilobytes."""
    return parquet_of(polars.DataFrame({name: np.zeros(9_000_000, np.int8) for name in "tabcdefg"}))


def parquet_lists() -> bytes:
    """One row whose list has 300 million numbers."""
    number = polars.Series([0], dtype=polars.UInt8).repeat_by(300_000_000)
    columns = {name: [0.0] for name in HEADER.decode().strip().split(",")}
    return parquet_of(polars.DataFrame({**columns, "more": number}))


def parquet_texts() -> bytes:
    """A column of texts of a megabyte each."""
    columns = dict.fromkeys(HEADER.decode().strip().split(","), [0.0] * 300)
    return parquet_of(polars.DataFrame({**columns, "more": ["a" * MB] * 300}))


def database(script: str) -> bytes:
    """A recording in SQLite with tables as rosbag2 has them, changed by a script."""
    with closing(sqlite3.connect(":memory:")) as file:
        file.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
            "serialization_format TEXT, offered_qos_profiles TEXT);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB);"
            "CREATE TABLE schema(schema_version INTEGER, ros_distro TEXT);"
            "INSERT INTO schema VALUES (4, 'jazzy');" + script
        )
        return file.serialize()


def endless_view() -> bytes:
    """Definitions of messages that are computed without end."""
    return database(
        "CREATE VIEW message_definitions AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT "
        "id + 1 FROM n) SELECT id, 'a' || id AS topic_type, 'ros2msg' AS encoding, "
        "hex(zeroblob(1000)) AS encoded_message_definition, '' AS type_description_hash FROM n;"
    )


def computed_column() -> bytes:
    """Messages of a gigabyte each that are computed."""
    return database(
        "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
        "timestamp INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)) VIRTUAL);"
        "CREATE TABLE message_definitions(id INTEGER, topic_type TEXT, encoding TEXT, "
        "encoded_message_definition TEXT, type_description_hash TEXT);"
        "INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr', '');"
        "INSERT INTO messages(id, topic_id, timestamp) VALUES (1, 1, 1), (2, 1, 2);"
    )


def ulog(definition: str) -> bytes:
    """A ULog with one definition of a message."""
    text = f"{definition}".encode()
    head = b"ULog\x01\x12\x35\x01" + bytes(8)
    flags = bytes(40)
    parts = [(b"B", flags), (b"F", text)]
    return head + b"".join(len(body).to_bytes(2, "little") + kind + body for kind, body in parts)


def ulog_array() -> bytes:
    """A ULog whose messages have two billion fields."""
    fields = "uint64_t timestamp;float[2000000000] q;"
    subscription = b"\x00\x00\x00vehicle_attitude"
    body = len(subscription).to_bytes(2, "little") + b"A" + subscription
    data = b"\x00\x00" + bytes(100)
    return ulog(f"vehicle_attitude:{fields}") + body + len(data).to_bytes(2, "little") + b"D" + data


def blackbox_fields() -> bytes:
    """A blackbox log of 200,000 fields."""
    names = ",".join(f"gyroADC[{number}]" for number in range(200_000))
    ones = ",".join("0" for _ in range(200_000))
    lines = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "I interval:32",
        "P interval:1/2",
        f"Field I name:loopIteration,time,{names}",
        *(f"Field {kind}:0,0,{ones}" for kind in ("I signed", "I predictor", "I encoding")),
    ]
    return "".join(f"H {line}\n" for line in lines).encode() + b"I" * 100


def card_log() -> bytes:
    """A micro-SD log whose records have thousands of variables."""
    names = b"".join(b"v%d(f)\x00" % number for number in range(60_000))
    event = b"fixedFrequency\x00" + (60_000).to_bytes(2, "little") + names
    return b"\xbc\x01\x00\x01\x00\x00\x00" + event + bytes(300_000)


def table_of_text() -> bytes:
    """A CSV table of a run of 70 MB."""
    return b"model,horizon\n" + b"a,1\n" * 17_500_000


def long_comment() -> bytes:
    """A comment of 5 MB above a log."""
    return b"# maidenflight log 3\n# " + b"a" * (5 * MB) + b"\n" + HEADER


def json_nests() -> bytes:
    """Brackets, each of which costs twenty times its length."""
    return b'{"format": "maidenflight policy 8", "a": [' + b"[]," * (6 * MB) + b"[]]}"


def json_twice() -> bytes:
    """A million keys, the last of them twice."""
    keys = ",".join(f'"k{number}": 0' for number in range(500_000))
    return f'{{{keys}, "k499999": 1}}'.encode()


def toml_long() -> bytes:
    """Three megabytes of tables, which Python reads at one a second."""
    return b"".join(b"[a%d]\n" % number for number in range(400_000))


def toml_dots() -> bytes:
    """A key of 20,000 names, of which Python's reader takes the square."""
    return b".".join([b"a"] * 20_000) + b" = 1\n"


def study_of_many() -> bytes:
    """A study of 200 million tasks."""
    grid = "seed = { first = 0, count = 200000 }, flights = { first = 1, count = 999 }"
    return f'[[task]]\nname = "a"\nkind = "record"\ngrid = {{ {grid} }}\n'.encode()


def study_of_a_million() -> bytes:
    """A study of a million tasks."""
    return (
        b'[[task]]\nname = "a"\nkind = "record"\ngrid = { seed = { first = 0, count = 1000000 } }\n'
    )


def rezipped(source: Path, **entries: bytes) -> bytes:
    """A zip file with entries in the place of others."""
    with zipfile.ZipFile(source) as file:
        content = {name: file.read(name) for name in file.namelist()}
    return zipped({**content, **{name.replace("__", "."): raw for name, raw in entries.items()}})


def zipped(entries: dict[str, bytes]) -> bytes:
    """A zip file."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as file:
        for name, raw in entries.items():
            file.writestr(name, raw)
    return content.getvalue()


def with_object(name: str, raw: bytes) -> bytes:
    """A policy of Stable-Baselines3 with a pickle in the place of an object."""
    with zipfile.ZipFile(SOUND) as file:
        data = json.loads(file.read("data"))
    data[name] = {":type:": "x", ":serialized:": base64.b64encode(raw).decode()}
    return rezipped(SOUND, data=json.dumps(data).encode())


def model_bomb() -> bytes:
    """A policy whose tensors unpack to 300 MB."""
    return rezipped(SOUND, policy__pth=ZEROS * 300)


def model_json() -> bytes:
    """A policy whose settings are 30 MB of brackets."""
    return rezipped(SOUND, data=b'{"a": [' + b"[]," * (10 * MB) + b"[]]}")


def model_entries() -> bytes:
    """A policy of 40,000 entries."""
    return zipped({f"{number}": b"" for number in range(40_000)})


def model_long_pickle() -> bytes:
    """A policy whose space is a pickle of a million instructions."""
    return with_object("observation_space", b"(" + b"N" * MB + b"t.")


def model_memory() -> bytes:
    """A policy whose pickle memorises at a far place, for which Python's reader makes room."""
    return with_object("observation_space", b"Nr\xff\xff\xff\x6f.")


def model_promise() -> bytes:
    """A policy whose pickle promises an exabyte."""
    return with_object("observation_space", b"\x96" + (2**60).to_bytes(8, "little") + b".")


def evil_call(name: str, *arguments: str) -> bytes:
    """A pickle that calls something of a module by texts."""
    module, _, attribute = name.rpartition(".")
    texts = b"".join(b"V" + one.encode() + b"\n" for one in arguments)
    return b"c" + f"{module}\n{attribute}\n".encode() + b"(" + texts + b"tR."


def model_code() -> bytes:
    """A policy that would run a shell command."""
    return with_object("observation_space", evil_call("os.system", "touch touched"))


def model_wrapped_code() -> bytes:
    """The same within Stable-Baselines3's own class, whose state is a pickle that it reads."""
    inner = evil_call("os.system", "touch touched")
    state = b"B" + len(inner).to_bytes(4, "little") + inner
    wrapper = b"cstable_baselines3.common.vec_env.base_vec_env\nCloudpickleWrapper\n"
    return with_object("observation_space", wrapper + b")\x81" + state + b"b.")


def model_emptying() -> bytes:
    """A policy that would empty a file by a class of Stable-Baselines3."""
    call = evil_call("stable_baselines3.common.logger.CSVOutputFormat", "touched")
    return with_object("action_space", call)


def checkpoint_promise() -> bytes:
    """A checkpoint whose array promises 80 GB."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (10**10,)}
    )
    return zipped({"title.npy": head.getvalue(), "leaf 0.npy": head.getvalue() + bytes(100)})


HOSTILE: dict[str, tuple[Callable[[], bytes], str]] = {
    "bomb.csv.gz": (gzip_bomb, "log FILE"),
    "line.csv.gz": (endless_line, "log FILE"),
    "columns.csv": (many_columns, "log FILE"),
    "rows.parquet": (parquet_rows, "log FILE"),
    "lists.parquet": (parquet_lists, "log FILE"),
    "texts.parquet": (parquet_texts, "log FILE"),
    "view.db3": (endless_view, "log FILE"),
    "computed.db3": (computed_column, "log FILE"),
    "array.ulg": (ulog_array, "log FILE"),
    "fields.bbl": (blackbox_fields, "log FILE"),
    "card": (card_log, "log FILE"),
    "comment.csv": (long_comment, "log FILE"),
    "nests.json": (json_nests, "export FILE"),
    "twice.json": (json_twice, "export FILE"),
    "long.toml": (toml_long, "drone FILE"),
    "dots.toml": (toml_dots, "drone FILE"),
    "plan.toml": (toml_dots, "record --plan FILE"),
    "billion.toml": (study_of_many, "sweep FILE --status"),
    "million.toml": (study_of_a_million, "sweep FILE --status"),
    "table.csv": (table_of_text, "report --validation FILE"),
    "bomb.zip": (model_bomb, "transfer FILE"),
    "json.zip": (model_json, "transfer FILE"),
    "entries.zip": (model_entries, "transfer FILE"),
    "instructions.zip": (model_long_pickle, "transfer FILE"),
    "memory.zip": (model_memory, "transfer FILE"),
    "promise.zip": (model_promise, "transfer FILE"),
    "code.zip": (model_code, "transfer FILE"),
    "wrapped.zip": (model_wrapped_code, "transfer FILE"),
    "emptying.zip": (model_emptying, "transfer FILE"),
    "policies/training.npz": (
        checkpoint_promise,
        "train --drone crazyflie --resume -o FOLDER/policies",
    ),
}
"""By the file's name, what makes it and the command that reads it."""


def write(folder: Path, name: str) -> Path:
    """Writes one of them."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(HOSTILE[name][0]())
    return path


if __name__ == "__main__":
    for each in HOSTILE:
        print(write(Path(sys.argv[1]), each))
