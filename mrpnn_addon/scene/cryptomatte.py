# SPDX-License-Identifier: GPL-3.0-or-later
"""Mattes of volumes by object and material, as Psyop's Cryptomatte specification 1.2.0 has them.

https://github.com/Psyop/Cryptomatte/blob/master/specification/cryptomatte_specification.pdf
"""

import json
from collections.abc import Sequence

import numpy as np

from ...inference.image.layer import Coverage
from ..runtime.text import safe_text

_WORD = 0xFFFFFFFF


def murmur3(text: bytes) -> int:
    """MurmurHash3, x86, 32 bits, seed 0 (Austin Appleby, public domain)."""
    value, whole = 0, len(text) // 4 * 4
    for start in range(0, len(text), 4):
        block = int.from_bytes(text[start : start + 4], "little")
        block = block * 0xCC9E2D51 & _WORD
        block = (block << 15 | block >> 17) & _WORD
        value ^= block * 0x1B873593 & _WORD
        if start < whole:
            value = (value << 13 | value >> 19) & _WORD
            value = (value * 5 + 0xE6546B64) & _WORD
    value ^= len(text)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        value = (value ^ value >> shift) * factor & _WORD
    return value ^ value >> 16


def matte_id(name: str) -> int:
    """The bits of the number in single precision that stands for a name: never a denormal, infinite or none."""
    bits = murmur3(safe_text(name).encode())
    return bits ^ 1 << 23 if bits >> 23 & 255 in (0, 255) else bits


def matte_passes(coverage: Coverage, names: Sequence[str], shape: tuple[int, ...], levels: int) -> list[np.ndarray]:
    """Images float32 (H, W, 4) of two levels each: id and coverage, id and coverage.

    names: of each of the volumes that `coverage` names. shape: (H, W). levels: how many names a pixel holds at most,
    those of the largest coverage.
    """
    different = sorted(set(names))
    count, pixels = max(len(different), 1), shape[0] * shape[1]
    of_volume = np.array([different.index(name) for name in names], np.int64)
    flat, of = np.unique(coverage.pixel * count + of_volume[coverage.volume], return_inverse=True)
    share = np.bincount(of.reshape(-1), coverage.share, len(flat))
    pixel, owner = flat // count, flat % count
    order = np.lexsort((owner, -share, pixel))
    pixel, owner, share = pixel[order], owner[order], share[order]
    rank = np.arange(len(pixel)) - np.searchsorted(pixel, pixel)
    ids = np.array([matte_id(name) for name in different], np.uint32).view(np.float32)
    images = np.zeros((-(-levels // 2) * 2, 2, pixels), np.float32)
    kept = rank < levels
    images[rank[kept], 0, pixel[kept]], images[rank[kept], 1, pixel[kept]] = ids[owner[kept]], share[kept]
    return [
        np.ascontiguousarray(images[n : n + 2].reshape(4, *shape).transpose(1, 2, 0)) for n in range(0, len(images), 2)
    ]


def matte_metadata(layer: str, names: Sequence[str]) -> dict[str, str]:
    """What a file says about the mattes of a layer, such as "ViewLayer.CryptoObject"."""
    key = f"cryptomatte/{murmur3(safe_text(layer).encode()):08x}"[: len("cryptomatte/") + 7]
    manifest = {safe_text(name): f"{matte_id(name):08x}" for name in sorted(set(names))}
    return {
        f"{key}/name": layer,
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        f"{key}/manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
    }
