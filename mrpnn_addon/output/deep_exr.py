# SPDX-License-Identifier: GPL-3.0-or-later
"""Deep images as OpenEXR files: one part of deep scanlines, ZIPS-compressed.

Written with NumPy, as flat files are: Blender's OpenImageIO module, which not every build ships, takes a call of Python
for each number. Channels have the plain names that compositors read: R, G, B and A in half precision, Z and ZBack.
"""

import struct
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ...inference.deep.deep_image import DeepImage
from ..runtime.atomic_write import atomic_write
from .exr_file import FLOAT_PIXELS, HALF_PIXELS, VERSION, ZIPS_COMPRESSION, exr_header, packed

# In the version field: some part is not a flat image.
DEEP = 0x800
# The largest half.
BRIGHTEST = 65504.0
# Scanlines that are compressed between two questions whether to stop.
LINES = 16


def write_deep(
    path: str, deep: DeepImage, metadata: Mapping[str, str | int | float], check: Callable[[], None] = lambda: None
) -> None:
    """Write a deep image. metadata, check: as of `write_exr`.

    The file appears at `path` only when it is complete. Raises OSError where it cannot be written.
    """
    height, width = deep.counts.shape
    colours = np.minimum(deep.rgba, BRIGHTEST).astype("<f2")
    channels = {
        **{name: colours[:, "RGBA".index(name)] for name in "ABGR"},
        "Z": deep.front.astype("<f4"),
        "ZBack": deep.back.astype("<f4"),
    }
    attributes = {
        **metadata,
        "type": "deepscanline",
        "version": 1,
        "chunkCount": height,
        "maxSamplesPerPixel": int(deep.counts.max(initial=0)),
    }
    pixels = {name: HALF_PIXELS if len(name) == 1 and name != "Z" else FLOAT_PIXELS for name in channels}
    header = exr_header(pixels, (width, height), attributes, ZIPS_COMPRESSION, VERSION | DEEP)
    ends = np.append(0, np.cumsum(deep.counts.sum(axis=1)))

    def chunk(y: int) -> bytes:
        if y % LINES == 0:
            check()
        table = np.cumsum(deep.counts[y], dtype="<i4").tobytes()
        raw = b"".join(values[ends[y] : ends[y + 1]].tobytes() for values in channels.values())
        offsets, data = packed(table), packed(raw) if raw else b""
        return struct.pack("<i3Q", y, len(offsets), len(data), len(raw)) + offsets + data

    with ThreadPoolExecutor() as pool:
        chunks = list(pool.map(chunk, range(height)))
    places = np.cumsum([len(header) + 8 * height, *map(len, chunks)], dtype="<u8")[:-1]
    with atomic_write(path) as file:
        file.write(header)
        file.write(places.tobytes())
        for number, one in enumerate(chunks):
            if number % LINES == 0:
                check()
            file.write(one)
