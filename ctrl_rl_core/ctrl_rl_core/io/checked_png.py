"""Checksums of PNG files, which Pillow does not verify for pixel data."""

from __future__ import annotations

import zlib
from typing import BinaryIO

from ctrl_rl_core.io.file_checks import FileError

_BEGIN, _END = b"\x89PNG\r\n\x1a\n", b"IEND"
_LARGEST = 200_000_000


def check_png(file: BinaryIO) -> None:
    """Raise if a PNG file is damaged, then rewind it; other file types pass.

    Raises:
        FileError: A checksum is wrong, or the file is truncated.
    """
    if file.read(len(_BEGIN)) == _BEGIN:
        kind = b""
        while kind != _END:
            head = file.read(8)
            size, kind = int.from_bytes(head[:4]), head[4:]
            data = file.read(size) if size <= _LARGEST else b""
            if len(head) < 8 or len(data) < size or file.read(4) != zlib.crc32(kind + data).to_bytes(4):
                raise FileError("is a damaged PNG: a checksum in it is wrong")
    file.seek(0)
