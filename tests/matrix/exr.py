# SPDX-License-Identifier: GPL-3.0-or-later
"""Channels of EXR files, read without any library: no Blender program brings one that reads passes.

Format: https://openexr.com/en/latest/OpenEXRFileLayout.html.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

KINDS = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
MULTIPART = 0x1000
# Lines in a block, by the kind of compression: none, each line, and sixteen together.
LINES = {0: 1, 2: 1, 3: 16}


def read_channels(path: str | Path) -> dict[str, np.ndarray]:
    """Every channel, float32 (H, W), by its name; in files of several parts after the part's name, but for what the two
    have in common. Raises ValueError where a part is tiled, or compressed otherwise than as ZIP.
    """
    data = Path(path).read_bytes()
    several = bool(struct.unpack_from("<I", data, 4)[0] & MULTIPART)
    at, parts = 8, []
    while data[at]:
        header, at = _header(data, at)
        parts.append(header)
        if not several:
            break
    at += several
    images = [_image(header) for header in parts]
    blocks = [-(-image["height"] // image["lines"]) for image in images]
    # The tables of offsets are needed only for blocks out of order.
    at += 8 * sum(blocks)
    for _ in range(sum(blocks)):
        number = struct.unpack_from("<i", data, at)[0] if several else 0
        at += 4 * several
        y, size = struct.unpack_from("<ii", data, at)
        _fill(images[number], y, data[at + 8 : at + 8 + size])
        at += 8 + size
    return {name: pixels for image in images for name, pixels in image["pixels"].items()}


def read_deep(path: str | Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Samples of each pixel of a file of one deep part, int (H, W), and those of each channel, pixel after pixel."""
    data = Path(path).read_bytes()
    header, at = _header(data, 8)
    image, counts = _image(header), []
    at += 8 * image["height"]
    samples: dict[str, list] = {name: [] for name, _ in image["channels"]}
    for _ in range(image["height"]):
        table, size, whole = struct.unpack_from("<3Q", data, at + 4)
        at += 28
        ends = _stored(data[at : at + table], 4 * image["width"])
        counts.append(np.diff(np.frombuffer(ends, "<i4"), prepend=0))
        block, place = _stored(data[at + table : at + table + size], whole), 0
        for name, kind in image["channels"]:
            samples[name].append(np.frombuffer(block, kind, counts[-1].sum(), place))
            place += samples[name][-1].nbytes
        at += table + size
    return np.array(counts), {name: np.concatenate(lines).astype(np.float32) for name, lines in samples.items()}


def _stored(block: bytes, size: int) -> bytes:
    """A block of so many bytes, which is stored as it is where it does not shrink."""
    return block if len(block) == size else _unpacked(block)


def _fill(image: dict, y: int, block: bytes) -> None:
    """Enter a block of lines, the first one of which is `y`."""
    first = y - image["top"]
    last = min(first + image["lines"], image["height"])
    whole = (last - first) * image["width"] * sum(kind.itemsize for _, kind in image["channels"])
    block, at = _stored(block, whole), 0
    for row in range(first, last):
        for name, kind in image["channels"]:
            line = np.frombuffer(block, kind, image["width"], at)
            image["pixels"][name][row] = line
            at += line.nbytes


def _unpacked(block: bytes) -> bytes:
    """Each byte is the difference from the one before, plus 128; the first half holds every other byte."""
    values = np.frombuffer(zlib.decompress(block), np.uint8).astype(np.int64)
    values[1:] -= 128
    values = (np.cumsum(values) % 256).astype(np.uint8)
    half = -(-len(values) // 2)
    apart = np.empty_like(values)
    apart[::2], apart[1::2] = values[:half], values[half:]
    return apart.tobytes()


def _header(data: bytes, at: int) -> tuple[dict[str, bytes], int]:
    found = {}
    while data[at]:
        name, at = _text(data, at)
        _, at = _text(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        found[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return found, at + 1


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def _image(header: dict[str, bytes]) -> dict:
    lines = LINES.get(header["compression"][0])
    if lines is None or "tiles" in header:
        raise ValueError("the file is tiled, or compressed otherwise than as ZIP")
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    shape, channels, at = (bottom - top + 1, right - left + 1), [], 0
    while header["channels"][at]:
        name, at = _text(header["channels"], at)
        channels.append((name, KINDS[struct.unpack_from("<i", header["channels"], at)[0]]))
        at += 16
    pixels = {name: np.zeros(shape, np.float32) for name, _ in channels}
    return dict(channels=channels, lines=lines, top=top, height=shape[0], width=shape[1], pixels=pixels)
