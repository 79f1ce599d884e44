"""Files that are written whole or not at all, and arrays read from files that anybody may have made."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from melp_warp.errors import InputError, require

MOST_MEMBERS = 200
"""Arrays that a file of arrays may hold."""

_UMASK = os.umask(0)
os.umask(_UMASK)


@contextlib.contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Give a new file to write beside `path`; at the end it is flushed to the disk and takes the place of `path`.

    Its name is random and it is made anew, so that no link that somebody laid there is written through. It starts with
    a dot, which keeps a leftover out of patterns such as film.*.usdc. If the block fails it is removed.

    Raises:
        InputError: the folder is the system's.
        OSError: the folder is missing or cannot be written, or the disk is full.
    """
    path = Path(path)
    require(not is_systems(path.parent), "file", str(path), "in a folder of a disk")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=f".tmp{path.suffix}", dir=path.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    os.close(handle)
    temporary = Path(name)
    try:
        with contextlib.suppress(OSError):
            temporary.chmod(0o666 & ~_UMASK)
        yield temporary
        sync(temporary, os.O_RDWR)
        os.replace(temporary, path)
        with contextlib.suppress(OSError):  # not every system can sync a folder
            sync(path.parent, os.O_RDONLY)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def is_systems(folder: Path) -> bool:
    """Whether a folder holds no files but devices and processes."""
    top = folder.resolve().parts[1:3]
    return top[:1] in (("dev",), ("proc",), ("sys",)) and top != ("dev", "shm")


def sync(path: Path, flags: int) -> None:
    """Flush what was written to a file or folder to the disk."""
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def append(path: Path, data: bytes) -> None:
    """Append to a file, all of the data or none of it.

    Raises:
        OSError: the folder is missing or cannot be written, or the disk is full.
    """
    with path.open("ab", buffering=0) as file:
        before, left = file.tell(), memoryview(data)
        try:
            while left:
                left = left[file.write(left) :]
        except OSError:
            file.truncate(before)
            raise


def digest(path: str | os.PathLike) -> str:
    """SHA-256 of a file, hexadecimal, as `sha256sum` prints it."""
    found = hashlib.sha256()
    with open(path, "rb") as file:
        while part := file.read(1 << 20):
            found.update(part)
    return found.hexdigest()


def save_arrays(path: str | os.PathLike, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays to a .npz file, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)


def load_arrays(path: str | os.PathLike, wanted: Mapping[str, tuple[str, int]]) -> dict[str, np.ndarray]:
    """Read the arrays `wanted` from a .npz file that anybody may have made; others are left unread.

    Members must be stored as they are, as `save_arrays` does: the file's size then bounds what is read, whatever its
    headers say. Nothing is unpickled, and the checksum of each member is checked.

    Args:
        path: the file.
        wanted: name -> kind ("f" for floats, "i" for whole numbers) and number of dimensions.

    Returns:
        The arrays that are there, by name.

    Raises:
        InputError: the file is missing, truncated, damaged or not such a file, or an array is of another kind.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} cannot be read: there is no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()[:MOST_MEMBERS]}
            return {
                name: _member(archive, members[name], name, kind, ndim)
                for name, (kind, ndim) in wanted.items()
                if name in members
            }
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # zipfile and NumPy raise a dozen kinds on damaged files
        raise InputError(f"{path} cannot be read: {_first_line(error)}") from None


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str, kind: str, ndim: int) -> np.ndarray:
    """One array of an archive."""
    if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
        raise InputError(f"{name} is compressed or encrypted, which no file of ours is")
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
        shape, fortran, dtype = read(file)
        if dtype.kind.replace("u", "i") != kind or dtype.itemsize not in (1, 4, 8) or len(shape) != ndim or fortran:
            raise InputError(f"{name} must have {ndim} dimensions of kind {kind!r}, it has {shape} of {dtype}")
        size = dtype.itemsize
        for length in shape:  # Python's whole numbers do not overflow
            size *= length
        if min(shape, default=0) < 0 or size > info.file_size:
            raise InputError(f"{name} says it is {shape} of {dtype}, more than the file holds")
        data = file.read(size)
        if len(data) != size or file.read(1):  # reading to the end checks the checksum
            raise InputError(f"{name} is truncated or too long")
    return np.frombuffer(data, dtype=dtype).reshape(shape).astype(dtype.newbyteorder("="))


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
