"""Files read and written whole: content and digest on the way in, all or nothing on the way out."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from orthoglide.errors import FileError


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """A file's content; a missing, empty or unreadable one is a `FileError`."""
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        raise FileError("there is no such file: check the name", file=str(path)) from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FileError(
            f"cannot be read ({reason}): give a readable file", file=str(path)
        ) from None
    if not content.strip():
        raise FileError("is empty: give a file with content", file=str(path))
    return content


_BINARY = {
    b"PK\x03\x04": "is a spreadsheet or archive: export the sheet as CSV (UTF-8)",
    b"\xd0\xcf\x11\xe0": "is an old spreadsheet: export the sheet as CSV (UTF-8)",
    b"\xff\xfe": "is UTF-16 text: save it as UTF-8",
    b"\xfe\xff": "is UTF-16 text: save it as UTF-8",
}


def decode(content: bytes, path: str | os.PathLike[str]) -> str:
    """UTF-8 text with or without byte order mark; anything else is a `FileError`."""
    for start, message in _BINARY.items():
        if content.startswith(start):
            raise FileError(message, file=str(path))
    if b"\0" in content:
        raise FileError("is not text: give a UTF-8 text file", file=str(path))
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise FileError("is not UTF-8 text: save it as UTF-8", file=str(path), line=line) from None


def sha256(content: bytes) -> str:
    """Digest of a file's content, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def write_whole(path: str | os.PathLike[str], content: str | bytes, *, overwrite: bool) -> None:
    """Writes a file that appears whole or not at all.

    Args:
        path: where to.
        content: what; text is encoded as UTF-8.
        overwrite: whether an existing file may be replaced.

    Raises:
        FileError: where a file stands already and may not be replaced, or none can be written.
    """
    target = Path(path)
    if not overwrite:
        check_new(target)
    with writing(path):
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=".orthoglide-")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content.encode() if isinstance(content, str) else content)
            os.chmod(name, 0o644)  # mkstemp's file is its owner's alone
            os.replace(name, target)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise


def check_new(path: str | os.PathLike[str]) -> None:
    """Refuse a name that stands already, or that no file can have, with a `FileError`."""
    with writing(path):
        stands = Path(path).exists()
    if stands:
        raise FileError("exists and is not overwritten: choose another name", file=str(path))


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """What the system refuses within is a `FileError` that names the path."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FileError(
            f"cannot be written ({reason}): choose another place or name", file=str(path)
        ) from None
