# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles packed into the textures that game engines read. Imports no bpy."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...inference.scene import SceneError
from ...inference.scene.environment import LUMA
from .light_maps import SIDES, Tile

#: Which side each colour channel of the two textures holds. UNITY is that of VFX Graph's Six-way Smoke Lit,
#: https://docs.unity3d.com/Packages/com.unity.visualeffectgraph@17.2/manual/six-way-lighting.html; RIGHT_LEFT_TOP is
#: the other usual one, which O3DE's tutorial reads beside many materials for Unreal.
LAYOUTS = {
    "UNITY": (("right", "top", "back"), ("left", "bottom", "front")),
    "RIGHT_LEFT_TOP": (("right", "left", "top"), ("bottom", "back", "front")),
}
# Alpha below which straight colours are those of the neighbours.
FAINT = 1e-3
# Largest width and height of a texture, as in game engines.
MAX_SIZE = 16384


@dataclass(frozen=True)
class Atlas:
    """Tiles in rows from the top, each row from the left.

    columns, rows: of tiles. tile: edge of one, pixels. padding: empty pixels at each of its edges. layout: a key of
    LAYOUTS. straight: whether colours are not premultiplied by alpha. normalized: whether the brightest light map
    becomes 1.

    Raises SceneError for a padding that leaves nothing, and for textures too large for game engines.
    """

    columns: int = 8
    rows: int = 8
    tile: int = 256
    padding: int = 2
    layout: str = "UNITY"
    straight: bool = False
    normalized: bool = False

    def __post_init__(self) -> None:
        if self.inner < 8:
            raise SceneError(f"tiles of {self.tile} pixels are too small; use a larger texture, or fewer tiles")
        if max(self.size) > MAX_SIZE:
            raise SceneError(f"textures of {self.size[0]} x {self.size[1]} pixels are too large for game engines")

    @property
    def inner(self) -> int:
        """Edge of a tile without its padding, pixels."""
        return self.tile - 2 * self.padding

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the textures, pixels."""
        return self.columns * self.tile, self.rows * self.tile

    def place(self, tiles: Sequence[np.ndarray | None], channels: int) -> np.ndarray:
        """A texture float32 (height, width, channels) of tiles (inner, inner, channels); None leaves one empty."""
        width, height = self.size
        texture = np.zeros((height, width, channels), np.float32)
        for number, pixels in enumerate(tiles):
            if pixels is not None:
                row, column = divmod(number, self.columns)
                x, y = column * self.tile + self.padding, row * self.tile + self.padding
                texture[y : y + self.inner, x : x + self.inner] = pixels
        return texture


@dataclass
class Textures:
    """images: by what the file's name ends in, float32 (H, W, 4). scale: by which light maps are multiplied.
    emission_scale: by which the radiance of the emission is divided. brightest: the light maps' brightest texel.
    clipped: share of their texels above 1. motion_scale: the largest component of motion vectors, in widths of a tile.
    """

    images: dict[str, np.ndarray]
    scale: float
    emission_scale: float
    brightest: float
    clipped: float
    motion_scale: float


def textures(atlas: Atlas, tiles: Sequence[Tile | None]) -> Textures:
    """The textures of a flipbook; None leaves a tile empty.

    "A" holds three light maps and alpha, "B" three light maps and the luminance of the emission. "emission" holds its
    colour, and "motion" the motion vectors, where there are any: 0.5 is none, 0 and 1 the largest to the left and
    right, and down and up.
    """
    shown = [tile for tile in tiles if tile is not None]
    brightest = max((float(tile.maps.max()) for tile in shown), default=0.0)
    glow = max((float(tile.emission.max()) for tile in shown), default=0.0)
    scale = 1.0 / brightest if atlas.normalized and brightest > 0.0 else 1.0
    images: dict[str, np.ndarray] = {}
    alpha = atlas.place([None if tile is None else tile.alpha[..., None] for tile in tiles], 1)
    names, clipped = list(SIDES), 0.0

    def colours(values: np.ndarray) -> np.ndarray:
        return straight_colours(values, alpha) if atlas.straight else values

    emission = atlas.place([None if tile is None else tile.emission for tile in tiles], 3) / (glow or 1.0)
    for name, sides, last in zip("AB", LAYOUTS[atlas.layout], (alpha, emission @ LUMA.astype(np.float32)[:, None])):
        order = [names.index(side) for side in sides]
        maps = colours(
            atlas.place([None if tile is None else tile.maps[..., order] for tile in tiles], 3) * np.float32(scale)
        )
        clipped = max(clipped, float((maps > 1.0 + 1e-6).any(axis=2).sum() / max((alpha > 0.0).sum(), 1)))
        images[name] = np.concatenate([maps, last], axis=2)
    if glow > 0.0:
        images["emission"] = np.concatenate([emission, np.ones_like(alpha)], axis=2)
    motions = [None if tile is None or tile.motion is None else tile.motion / atlas.tile for tile in tiles]
    fastest = max((float(np.abs(motion).max()) for motion in motions if motion is not None), default=0.0)
    if fastest > 0.0:
        # Beyond the smoke, where textures are filtered, it moves on.
        moved = straight_colours(atlas.place(motions, 2) * alpha, alpha) / np.float32(fastest)
        images["motion"] = np.concatenate([0.5 + 0.5 * moved, np.zeros_like(alpha), np.ones_like(alpha)], axis=2)
    return Textures(
        images=images,
        scale=scale,
        emission_scale=glow or 1.0,
        brightest=max(float(images[name][..., :3].max()) for name in "AB"),
        clipped=clipped,
        motion_scale=fastest,
    )


def straight_colours(values: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Values (H, W, C) divided by alpha (H, W, 1). Where it is 0, the colours of neighbours, for texture filters."""
    known = alpha[..., 0] > FAINT
    found = np.where(known[..., None], values / np.maximum(alpha, FAINT), 0.0).astype(np.float32)
    for _ in range(4):
        total, count = np.zeros_like(found), np.zeros_like(alpha)
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            there = np.roll(known, step, axis)
            total += np.roll(found, step, axis) * there[..., None]
            count += there[..., None]
        new = ~known & (count[..., 0] > 0.0)
        found[new] = (total / np.maximum(count, 1.0))[new]
        known = known | new
    return found
