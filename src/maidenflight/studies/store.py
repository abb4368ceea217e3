"""Where the results of a study are: a folder each, named by its key, whole or not at all.

A store is a folder, which machines share, or an address of fsspec such as s3://BUCKET/STUDY.
"""

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from maidenflight import budget, cache, inputs, results
from maidenflight.errors import InputError, WriteError, imported

RESULT = "result.json"
"""In the folder of a result: its rows and record."""
_RESULTS = "results"
_REMOTE = re.compile(r"[a-z][a-z0-9+.-]+://")


class Folder:
    """A store in a folder."""

    def __init__(self, path: Path):
        """Begins with the study's folder.

        Raises:
            InputError: it is a file.
        """
        if path.is_file():
            raise InputError(f"{path}: is a file. Give a folder for the results with -o.")
        self._path = path.resolve()
        self._results = self._path / _RESULTS

    @property
    def address(self) -> str:
        """By which `opened` opens it on another machine."""
        return str(self._path)

    def keys(self) -> set[str]:
        """Returns keys of all results that are there."""
        with suppress(FileNotFoundError):
            return {name for name in os.listdir(self._results) if not name.startswith(".")}
        return set()

    def has(self, key: str) -> bool:
        """Returns whether a result is there."""
        return (self._results / key).is_dir()

    def folder(self, key: str) -> Path:
        """Returns a result's files on this machine."""
        return self._results / key

    def result(self, key: str) -> dict[str, Any]:
        """Returns what `RESULT` of it holds."""
        path = self._results / key / RESULT
        try:
            return inputs.from_json(inputs.text(path, budget.JSON))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{path}: not a whole result ({error}). Remove its folder, and sweep again."
            ) from error

    def remove(self, key: str) -> None:
        """Removes a result, if it is there."""
        # Out of the way first: what is half removed is no result.
        going = self._results / f".{key}.going_on.part"
        shutil.rmtree(going, ignore_errors=True)
        with suppress(FileNotFoundError):
            os.rename(self._results / key, going)
        shutil.rmtree(going, ignore_errors=True)

    @contextmanager
    def making(self, key: str) -> Iterator[Path]:
        """Returns a context with an empty folder, which becomes result where nothing is raised."""
        try:
            self._results.mkdir(parents=True, exist_ok=True)
            folder = Path(tempfile.mkdtemp(prefix=f".{key}.", suffix=".part", dir=self._results))
            folder.chmod(0o755)
        except OSError as error:
            raise WriteError(self._results, error) from error
        try:
            yield folder
            _to_disk(folder)
            try:
                os.rename(folder, self._results / key)
                _to_disk(self._results)
            except OSError:
                if not self.has(key):  # another has made the same meanwhile
                    raise
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def write(self, name: str, content: str) -> None:
        """Writes a file of the study beside the results, whole or not at all."""
        results.write(self._path / name, content)

    def read(self, name: str) -> str | None:
        """Its content; None where there is none."""
        with suppress(FileNotFoundError):
            return inputs.text(self._path / name, budget.JSON)
        return None

    def drop(self, name: str) -> None:
        """Removes it, if it is there."""
        (self._path / name).unlink(missing_ok=True)

    def tidy(self) -> None:
        """Removes what killed tasks have left of results that are there now."""
        for left in self._results.glob(".*.part"):
            if self.has(left.name.split(".")[1]):
                shutil.rmtree(left, ignore_errors=True)


class Address:
    """A store at an address of fsspec.

    An object store renames nothing: a result is there once its `RESULT` is, which is written last.
    What tasks take is fetched to this machine's folder for temporary files, once.
    """

    def __init__(self, address: str):
        """Begins with the study's address.

        Raises:
            InputError: fsspec, or its package for this kind of address, is not installed.
        """
        fsspec = imported("fsspec", "remote", address)
        try:
            self._files, self._root = fsspec.core.url_to_fs(address)
        except (ImportError, ValueError) as error:
            raise InputError(
                f"{address}: cannot be opened ({error}). Install fsspec's package for it, such as "
                "s3fs for s3://, on every machine."
            ) from error
        self._address = address

    @property
    def address(self) -> str:
        """See `Folder`."""
        return self._address

    def _at(self, *names: str) -> str:
        return "/".join((self._root, *names))

    def keys(self) -> set[str]:
        """See `Folder`."""
        self._files.invalidate_cache()
        files = self._files.glob(self._at(_RESULTS, "*", RESULT))
        return {str(path).split("/")[-2] for path in files}

    def has(self, key: str) -> bool:
        """See `Folder`."""
        self._files.invalidate_cache()
        return bool(self._files.exists(self._at(_RESULTS, key, RESULT)))

    def folder(self, key: str) -> Path:
        """See `Folder`."""
        # In the user's own cache, which nobody else may write to; anew where it was computed again.
        path = cache.folder() / "results" / hashlib.sha256(self._address.encode()).hexdigest()[:16]
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        fetched = Folder(path)
        if fetched.has(key) and fetched.result(key) != self.result(key):
            fetched.remove(key)
        if not fetched.has(key):
            with fetched.making(key) as path:
                self._files.get(f"{self._at(_RESULTS, key)}/", f"{path}/", recursive=True)
        return fetched.folder(key)

    def result(self, key: str) -> dict[str, Any]:
        """See `Folder`."""
        return json.loads(self._files.cat_file(self._at(_RESULTS, key, RESULT)))

    def remove(self, key: str) -> None:
        """See `Folder`."""
        with suppress(FileNotFoundError):
            self._files.rm_file(self._at(_RESULTS, key, RESULT))
            self._files.rm(self._at(_RESULTS, key), recursive=True)

    @contextmanager
    def making(self, key: str) -> Iterator[Path]:
        """See `Folder`."""
        with tempfile.TemporaryDirectory(prefix="maidenflight-") as name:
            folder = Path(name)
            yield folder
            files = sorted(path for path in folder.rglob("*") if path.is_file())
            for path in sorted(files, key=lambda path: path == folder / RESULT):
                address = self._at(_RESULTS, key, *path.relative_to(folder).parts)
                self._files.makedirs(address.rpartition("/")[0], exist_ok=True)
                self._files.put_file(str(path), address)

    def write(self, name: str, content: str) -> None:
        """See `Folder`."""
        address = self._at(name)
        self._files.makedirs(address.rpartition("/")[0], exist_ok=True)
        self._files.pipe_file(address, content.encode())

    def read(self, name: str) -> str | None:
        """See `Folder`."""
        self._files.invalidate_cache()
        with suppress(FileNotFoundError):
            return self._files.cat_file(self._at(name)).decode()
        return None

    def drop(self, name: str) -> None:
        """See `Folder`."""
        with suppress(FileNotFoundError):
            self._files.rm_file(self._at(name))

    def tidy(self) -> None:
        """See `Folder`."""


Store = Folder | Address
"""Results by key, and files beside them."""


def opened(address: inputs.StrPath) -> Store:
    """Returns the store of a folder, or of an address such as s3://BUCKET/STUDY.

    Raises:
        InputError: see `Address`.
    """
    name = os.fspath(address)
    return Address(name.rstrip("/")) if _REMOTE.match(name) else Folder(Path(name))


def _to_disk(folder: Path) -> None:
    """Makes sure that a power cut leaves what was written to a folder."""
    with suppress(OSError):  # not every file system can
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
