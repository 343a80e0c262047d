# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes OpenEXR files: one part, float channels, ZIP-compressed scanlines.

Format: https://openexr.com/en/latest/OpenEXRFileLayout.html. Implemented with NumPy and zlib: not every Blender has an
EXR writer for Python, and OpenEXR's package cannot be shipped, because its C functions bind to those of Blender's
different version of OpenEXR, which crashes.
"""

import struct
import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..runtime.atomic_write import atomic_write
from ..runtime.text import safe_text

MAGIC = 20000630
VERSION = 2
LONG_NAMES = 0x400
HALF_PIXELS, FLOAT_PIXELS = 1, 2
# Of one scanline, and of sixteen.
ZIPS_COMPRESSION, ZIP_COMPRESSION = 2, 3
LINES_PER_BLOCK = 16
MAX_NAME_BYTES = 255


def write_exr(
    path: str,
    channels: dict[str, np.ndarray],
    attributes: dict[str, str | list[str] | int | float],
    check: Callable[[], None] = lambda: None,
) -> None:
    """Write `channels`, float32 (H, W) each with rows from the top, under their names.

    attributes: written to the header as string, string vector, int and float attributes. check: called often; an
    exception that it raises stops the writing and leaves no file.

    The file appears at `path` only when it is complete. Raises OSError where it cannot be written.
    """
    names = sorted(channels)
    height, width = channels[names[0]].shape
    header = exr_header(dict.fromkeys(names, FLOAT_PIXELS), (width, height), attributes)

    def compressed(y: int) -> bytes:
        check()
        # Scanlines store one channel after another, in the order of their names: (lines, C, W).
        rows = [np.asarray(channels[name][y : y + LINES_PER_BLOCK], dtype="<f4") for name in names]
        return packed(np.stack(rows, axis=1).tobytes())

    with ThreadPoolExecutor() as pool:
        blocks = list(pool.map(compressed, range(0, height, LINES_PER_BLOCK)))

    # The header is followed by a table of the blocks' offsets in the file.
    place = len(header) + 8 * len(blocks)
    places = []
    for block in blocks:
        places.append(place)
        place += 8 + len(block)

    with atomic_write(path) as file:
        file.write(header)
        file.write(struct.pack(f"<{len(places)}Q", *places))
        for index, block in enumerate(blocks):
            check()
            file.write(struct.pack("<ii", index * LINES_PER_BLOCK, len(block)))
            file.write(block)


def packed(raw: bytes) -> bytes:
    """Bytes of scanlines as OpenEXR's ZIP compresses them; unchanged where that makes them no shorter."""
    data = np.frombuffer(raw, dtype=np.uint8)
    # Even bytes, then odd bytes, each as the difference from the previous one, plus 128.
    split = np.concatenate([data[0::2], data[1::2]])
    split[1:] = np.diff(split) + np.uint8(128)
    shorter = zlib.compress(split.tobytes(), 4)
    return shorter if len(shorter) < len(raw) else raw


def exr_header(
    pixels: Mapping[str, int],
    size: tuple[int, int],
    attributes: Mapping[str, int | float | str | list[str]],
    compression: int = ZIP_COMPRESSION,
    flags: int = VERSION,
) -> bytes:
    """What a file begins with. pixels: the type of each channel. size: (width, height). flags: of the version field.

    Raises ValueError for names that are too long.
    """
    names = {safe_text(name): kind for name, kind in pixels.items()}
    attributes = {safe_text(name): of for name, of in attributes.items()}
    longest = max(len(name.encode()) for name in [*names, *attributes])
    if longest > MAX_NAME_BYTES:
        raise ValueError(f"EXR names hold at most {MAX_NAME_BYTES} bytes, not {longest}")
    window = struct.pack("<4i", 0, 0, size[0] - 1, size[1] - 1)
    entries = [
        ("channels", "chlist", b"".join(_channel(*one) for one in names.items()) + b"\0"),
        ("compression", "compression", bytes([compression])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
        *(_attribute(name, value) for name, value in attributes.items()),
    ]
    body = b"".join(
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in entries
    )
    return struct.pack("<ii", MAGIC, flags | (LONG_NAMES if longest > 31 else 0)) + body + b"\0"


def _channel(name: str, kind: int) -> bytes:
    # Pixel type, linear flag with 3 reserved bytes, sampling 1 x 1.
    return name.encode() + b"\0" + struct.pack("<iBxxxii", kind, 0, 1, 1)


def _attribute(name: str, value: int | float | str | list[str]) -> tuple[str, str, bytes]:
    if isinstance(value, str):
        return name, "string", safe_text(value).encode()
    if isinstance(value, list):
        texts = [safe_text(text).encode() for text in value]
        return name, "stringvector", b"".join(struct.pack("<i", len(text)) + text for text in texts)
    if isinstance(value, int):
        return name, "int", struct.pack("<i", value)
    return name, "float", struct.pack("<f", value)
