"""Files: read in one go, and written completely or not at all."""

from __future__ import annotations

import hashlib
import os
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from orthoglide.errors import FileError, as_path
from orthoglide.text import printable_path

TEXT_LIMIT = 2**20
"""Largest file that people write by hand, bytes; such files are parsed key by key."""

FILE_LIMIT = 128 * 2**20
"""Largest file that is read, bytes: beyond a result with some hundred thousand readings."""

_BOM = b"\xef\xbb\xbf"


_CONTENT_AND_REMEDY = {
    "result.json": ("result", "a folder that close-loop, identify or check wrote with --out"),
    "calibrated.toml": (
        "calibrated machine", "a machine file, or a folder that close-loop or identify wrote"
    ),
    "printer.cfg": ("printer.cfg", "a printer's file by its name, or the folder that has it"),
}  # fmt: skip
"""Files that are read of a folder, each with what the folder then holds and what to give else."""

_MOST_FOLDERS = 3  # folders that a message names


def result_file(path: str | os.PathLike[str], name: str) -> Path:
    """Return the file of a result in a given folder; any other path unchanged.

    Raises:
        FileError: for a folder without that file; folders in it that have it are named.
    """
    location = as_path(path)
    if not location.is_dir():
        return location
    try:
        (location / name).stat()
    except FileNotFoundError:
        content, remedy = _CONTENT_AND_REMEDY[name]
        folders = sorted(str(file.parent) for file in location.glob(f"*/{name}"))
        remedy = " or ".join(map(printable_path, folders[:_MOST_FOLDERS])) or remedy
        raise FileError(f"this folder holds no {content}: give {remedy}", file=path) from None
    except OSError:
        pass  # reading the file says why
    return location / name


def read_bytes(path: str | os.PathLike[str], max_size: int | None = None) -> bytes:
    """Return the content of a file of at most ``max_size`` bytes.

    Raises:
        FileError: where it is missing, empty, unreadable, too large, or a pipe or a device, which
            may never end.
        InputError: for what is no path.
    """
    as_path(path)
    max_size = FILE_LIMIT if max_size is None else max_size
    try:
        kind = os.stat(path).st_mode
        if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
            raise FileError("is a pipe or a device: give a file", file=path)
        with open(path, "rb") as stream:
            content = stream.read(max_size + 1)
    except FileNotFoundError:
        problem = "there is no such file: check the name"
    except OSError as error:
        problem = f"cannot be read ({system_reason(error)}): give a readable file"
    else:
        if len(content) > max_size:
            problem = f"is larger than {max_size // 2**20} MB: give the right file"
        elif not content.removeprefix(_BOM).strip():
            problem = "is empty: give a file with content"
        else:
            return content
    raise FileError(problem, file=path)


def system_reason(error: OSError) -> str:
    """Return what the operating system says of an error, as a clause."""
    return (error.strerror or str(error)).lower()


_BINARY = {
    b"PK\x03\x04": "is a spreadsheet or archive: export the sheet as CSV (UTF-8)",
    b"\xd0\xcf\x11\xe0": "is an old spreadsheet: export the sheet as CSV (UTF-8)",
    b"\xff\xfe": "is UTF-16 text: save it as UTF-8",
    b"\xfe\xff": "is UTF-16 text: save it as UTF-8",
}


def decode(content: bytes, path: str | os.PathLike[str], errors: str = "strict") -> str:
    """Return the text of UTF-8 content with or without byte order mark; with ``errors="replace"``
    invalid characters do not matter.

    Raises:
        FileError: for anything else than UTF-8 text.
    """
    for start, message in _BINARY.items():
        if content.startswith(start):
            raise FileError(message, file=path)
    if b"\0" in content:
        raise FileError("is not text: give a UTF-8 text file", file=path)
    try:
        return content.decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise FileError("is not UTF-8 text: save it as UTF-8", file=path, line=line) from None


def sha256(content: bytes) -> str:
    """Return the digest of a file's content, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def write_file(path: str | os.PathLike[str], content: str | bytes, *, overwrite: bool) -> None:
    """Write a file completely or not at all; raises as :func:`write_files`."""
    write_files({as_path(path): content}, overwrite=overwrite)


def write_files(contents: Mapping[Path, str | bytes], *, overwrite: bool = False) -> None:
    """Write files completely, all of them or none; text is encoded as UTF-8.

    Raises:
        FileError: where a file exists and may not be replaced, or a file cannot be written.
    """
    temporary, written = dict[Path, Path](), list[Path]()
    try:
        for target, content in contents.items():
            if not overwrite:
                check_new(target)
            with as_file_errors(target):
                temporary[target] = temporary_path(target)
                with temporary[target].open("xb") as stream:
                    stream.write(content.encode() if isinstance(content, str) else content)
        for target, source in temporary.items():
            with as_file_errors(target):
                _move_into_place(source, target, overwrite)
            written.append(target)
    except BaseException:
        for target in written if not overwrite else ():
            target.unlink(missing_ok=True)
        raise
    finally:
        for source in temporary.values():
            source.unlink(missing_ok=True)


def temporary_path(target: Path) -> Path:
    """Return the path of a temporary file beside ``target``.

    It is known before the file is created, so that an interrupt at any moment can remove the file.
    """
    return target.parent / f".orthoglide-{secrets.token_hex(8)}"


def _move_into_place(name: Path, target: Path, overwrite: bool) -> None:
    """Rename a finished file; another process may have created the target meanwhile."""
    if overwrite:
        os.replace(name, target)
        return
    try:
        os.link(name, target)  # never replaces another file or a dangling link
    except FileExistsError:
        raise _exists_error(target) from None
    except OSError:  # a file system without hard links: take the name, then fill it
        try:
            os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        except FileExistsError:
            raise _exists_error(target) from None
        os.replace(name, target)


def _exists_error(path: str | os.PathLike[str]) -> FileError:
    return FileError("exists and is not overwritten: choose another name", file=path)


def check_new(path: str | os.PathLike[str]) -> None:
    """Raise a `FileError` for a name that exists, or that no file can have."""
    with as_file_errors(path):
        try:
            os.lstat(path)  # a dangling link counts as existing
        except (FileNotFoundError, NotADirectoryError):
            return
    raise _exists_error(path)


@contextmanager
def as_file_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn errors of the system within the block into a `FileError` that names the path."""
    try:
        yield
    except OSError as error:
        raise FileError(
            f"cannot be written ({system_reason(error)}): choose another place or name", file=path
        ) from None
