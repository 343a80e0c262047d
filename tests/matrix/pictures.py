# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that Blender's render writes, and how far two of them may lie apart."""

import itertools
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from tests.support import blender_scenes

from .exr import read_channels

# Names of passes before 5.0, and since.
PARTS = (
    ("Volume Direct", "Volume Indirect", "Emission")
    if bpy.app.version >= (5, 0, 0)
    else ("VolumeDir", "VolumeInd", "Emit")
)
_numbers = itertools.count()


@dataclass
class Picture:
    """Channels of a multi-layer EXR file, float32 (H, W) each, by name."""

    channels: dict[str, np.ndarray]

    def colour(self, name: str, letters: str = "RGB") -> np.ndarray:
        """A pass, (H, W, letters)."""
        return np.stack([self.channels[f"{name}.{letter}"] for letter in letters], axis=-1)

    def layer(self, view_layer: str = "ViewLayer") -> np.ndarray:
        """The volumes' light without what is behind them, (H, W, 3): the sum of the parts."""
        return np.sum([self.colour(f"{view_layer}.{part}") for part in PARTS], axis=0)


def write_passes(scene: "bpy.types.Scene") -> None:
    """Have renders written with the parts of their light, as `read_channels` reads them."""
    for layer in scene.view_layers:
        layer.mrpnn.use_pass_volume_direct = layer.mrpnn.use_pass_volume_indirect = True
        layer.mrpnn.use_pass_emission = True
    blender_scenes.write_multilayer(scene)
    scene.render.image_settings.exr_codec = "ZIP"


def render(scene: "bpy.types.Scene", folder: Path, suffixes: tuple[str, ...] = ("",)) -> dict[str, Picture]:
    """F12: a picture for each view, by the suffixes of their files."""
    path = folder / f"render{next(_numbers)}.exr"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return {suffix: read_picture(path, suffix) for suffix in suffixes}


def read_picture(path: Path, suffix: str = "") -> Picture:
    """The picture of a view, whose suffix stands before the file's extension."""
    return Picture(read_channels(path.with_stem(path.stem + suffix)))


def image_pixels(image: "bpy.types.Image") -> np.ndarray:
    """An Image's pixels, (H, W, 4), rows from the top."""
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, 4)[::-1]


def check_range(what: str, rgba: np.ndarray) -> None:
    """Finite, not negative, alpha within 0 and 1."""
    assert np.isfinite(rgba).all(), f"{what}: holds values that are not finite"
    assert rgba.min() >= -1e-5, f"{what}: holds {rgba.min():.3g}"
    if rgba.shape[-1] == 4:
        assert rgba[..., 3].max() <= 1.0 + 1e-4, f"{what}: alpha reaches {rgba[..., 3].max():.5g}"


def check_same(what: str, found: np.ndarray, expected: np.ndarray, within: float) -> None:
    """The largest difference, relative to the brightest expected value, is at most `within`."""
    assert found.shape == expected.shape, f"{what}: {found.shape} instead of {expected.shape}"
    apart = float(np.abs(found - expected).max() / max(np.abs(expected).max(), 1e-6))
    means = f"means {found.mean():.5g} and {expected.mean():.5g}"
    assert apart <= within, f"{what}: differs by {apart:.3g} of the brightest, more than {within:g} ({means})"


def check_near(what: str, found: np.ndarray, expected: np.ndarray, within: float) -> None:
    """The root mean square difference, relative to the brightest expected value, is at most `within`: a pixel at the
    edge of a surface may fall to either side.
    """
    assert found.shape == expected.shape, f"{what}: {found.shape} instead of {expected.shape}"
    apart = float(np.sqrt(np.mean((found - expected) ** 2)) / max(np.abs(expected).max(), 1e-6))
    means = f"means {found.mean():.5g} and {expected.mean():.5g}"
    assert apart <= within, f"{what}: differs by {apart:.3g} of the brightest, more than {within:g} ({means})"
