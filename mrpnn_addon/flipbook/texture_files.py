# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes textures as PNG, TGA or OpenEXR: linear data without a colour space, alpha unassociated. Imports no bpy.

Blender's own PNG files hold colours that went through a colour space, divided by alpha: light maps would be changed.
Formats: https://www.w3.org/TR/png-3/, Truevision TGA File Format Specification 2.0.
"""

import struct
import zlib
from collections.abc import Callable, Iterator

import numpy as np

from ..output.exr_file import write_exr
from ..runtime.atomic_write import atomic_write

#: The ending of each format's files, and the bits of its channels.
FORMATS = {"PNG": (".png", 8), "PNG16": (".png", 16), "TGA": (".tga", 8), "EXR": (".exr", 16)}
# Rows that are compressed at a time, so that a check comes often.
ROWS = 64


def write_texture(path: str, pixels: np.ndarray, file_format: str, check: Callable[[], None] = lambda: None) -> None:
    """Write float32 (H, W, 4), rows from the top. file_format: a key of FORMATS. check: as of `write_exr`.

    Integers hold 0 to 1; values beyond are clipped. OpenEXR files hold half floats. The file appears at `path` only
    when it is complete. Raises OSError where it cannot be written.
    """
    if file_format == "EXR":
        largest = float(np.finfo(np.float16).max)
        half = np.clip(pixels, -largest, largest).astype(np.float16)
        write_exr(path, {name: half[..., channel] for channel, name in enumerate("RGBA")}, {}, check)
        return
    bits = FORMATS[file_format][1]
    kind = np.uint8 if bits == 8 else np.dtype(">u2")
    values = np.rint(np.clip(pixels, 0.0, 1.0) * (2**bits - 1)).astype(kind)
    with atomic_write(path) as file:
        for block in (_tga if file_format == "TGA" else _png)(values, bits):
            check()
            file.write(block)


def _tga(values: np.ndarray, bits: int) -> Iterator[bytes]:
    """Uncompressed true-colour image, 8 of its 32 bits alpha, rows from the top."""
    height, width = values.shape[:2]
    yield struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, width, height, 4 * bits, 0x20 | bits)
    yield np.ascontiguousarray(values[..., [2, 1, 0, 3]]).tobytes()


def _png(values: np.ndarray, bits: int) -> Iterator[bytes]:
    height, width = values.shape[:2]
    yield b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 6, 0, 0, 0))
    # Gamma 1: the values are linear.
    yield _chunk(b"gAMA", struct.pack(">I", 100000))
    packed = zlib.compressobj(6)
    for first in range(0, height, ROWS):
        rows = np.ascontiguousarray(values[first : first + ROWS]).view(np.uint8).reshape(-1, width * bits // 2)
        # Filter 1: differences from the pixel to the left.
        filtered = rows.copy()
        filtered[:, bits // 2 :] -= rows[:, : -bits // 2]
        marked = np.concatenate([np.ones((len(rows), 1), np.uint8), filtered], axis=1)
        block = packed.compress(marked.tobytes())
        if block:
            yield _chunk(b"IDAT", block)
    yield _chunk(b"IDAT", packed.flush()) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
