"""What grows without bound when it is unpacked is refused before it fills the memory."""

import gzip
import io
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import polars
import pytest

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.flights import tables
from maidenflight.training import checkpoint


def test_a_gzip_bomb_is_refused_within_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "bomb.csv.gz"
    packer = zlib.compressobj(9, wbits=31)
    zeros = bytes(10_000_000)
    path.write_bytes(b"".join([*(packer.compress(zeros) for _ in range(40)), packer.flush()]))
    assert path.stat().st_size < 500_000
    tracemalloc.start()
    with pytest.raises(InputError, match=r"bomb\.csv\.gz: .*0\.4 MB that unpack to .* MB or more"):
        tables.content(path)
    assert tracemalloc.get_traced_memory()[1] < 400_000_000
    tracemalloc.stop()


def test_members_and_padding_of_a_gzip_file_are_read_and_a_cut_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(b"a,b\n") + gzip.compress(b"1,2\n") + bytes(512))
    assert b"".join(inputs.blocks(path, 3)) == b"a,b\n1,2\n"
    path.write_bytes(gzip.compress(bytes(100_000))[:-20])
    with pytest.raises(EOFError):
        list(inputs.blocks(path, 1000))


def test_a_parquet_bomb_is_refused_by_its_footer() -> None:
    packed = io.BytesIO()
    polars.DataFrame({"t": np.zeros(9_000_000, np.int8)}).write_parquet(packed)
    assert len(packed.getvalue()) < 100_000
    with pytest.raises(InputError, match=r"that unpack to 72 MB or more"):
        tables.parsed(packed.getvalue(), Path("log.parquet"), "log")


def test_a_zip_bomb_is_no_checkpoint(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "training.npz", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("title.npy", bytes(100_000_000))
    with pytest.raises(InputError, match=r"not a checkpoint of training .*unpack to 100 MB"):
        checkpoint.stages(tmp_path / "training.npz")
