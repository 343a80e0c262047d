# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render gives on request besides colours: deep samples, coverage by volumes, depth of the median, shadow."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..blur.reconstruction import join
from ..deep.deep_image import DeepImage
from ..image.camera_pass import STEPS_PER_TASK, tile_rays
from ..image.context import ChannelPass, PreparedScene, RenderContext, Tile
from ..image.framebuffer import Window
from ..image.layer import Coverage, Layer
from ..image.tile_estimate import TileEstimate
from ..marching.depth_samples import DepthSamples
from ..marching.marcher import Marcher
from ..marching.ray_march import MarchOptions
from ..scene.camera import Camera
from ..scene.description import Surface
from ..scene.errors import SceneError
from .deep_slices import DeepSlicer, DeepTile
from .surface_shadow import surface_shadow

# Moments of light along rays that deep samples are made from.
MOMENTS = 6


@dataclass
class Outputs:
    """The outputs of `Settings.outputs` of a camera's window, of the tiles that are finished.

    Tiles may be added by several threads. In blurred pictures, median and shadow are those of the lens' middle, at the
    time of the frame.

    Raises SceneError for deep samples of blurred pictures.
    """

    wanted: frozenset[str]
    camera: Camera
    _deep: dict[Window, DeepTile | None] = field(default_factory=dict)
    _coverage: list[Coverage] = field(default_factory=list)
    _names: Sequence[str] = ()
    _median: np.ndarray | None = None
    _shadow: np.ndarray | None = None

    def __post_init__(self) -> None:
        blur = "depth of field" if self.camera.lens else "motion blur" if self.camera.shutter else None
        if "deep" in self.wanted and blur:
            raise SceneError(f"deep EXR does not work with {blur}; switch off one of them")
        if "median" in self.wanted:
            x0, y0, x1, y1 = self.camera.window
            # Sums of distance times weight, and weights.
            self._median = np.zeros((2, y1 - y0, x1 - x0), np.float32)

    @property
    def moments(self) -> int:
        """As of TileEstimate."""
        return MOMENTS if "deep" in self.wanted else 1

    def of_pass(self, context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass) -> "PassOutputs":
        """What a pass of colour channels adds."""
        self._names = [volume.name for volume, _ in scene.plan.volumes]
        return PassOutputs(self, context, scene, channel_pass)

    def join(self, sharpness: np.ndarray, each: Callable[..., Iterable[None]]) -> None:
        """Join pixels of a blurred picture, whose sharpness (P, 4) is as of `blur.reconstruction`."""
        if "coverage" not in self.wanted:
            return
        (x0, y0, x1, y1), found = self.camera.window, Coverage.joined(self._coverage, self._names)
        sharpness, self._coverage = sharpness.reshape(y1 - y0, x1 - x0, 4), []
        for volume in np.unique(found.volume):
            image, own = np.zeros((y1 - y0) * (x1 - x0), np.float32), found.volume == volume
            image[found.pixel[own]] = found.share[own]
            [joined] = join([image.reshape(sharpness.shape[:2])], sharpness, each)
            pixel = np.flatnonzero(joined)
            self._coverage.append(Coverage(pixel, np.full(len(pixel), volume), joined.ravel()[pixel]))

    def add_shadow(self, context: RenderContext, scene: PreparedScene, surfaces: Sequence[Surface]) -> None:
        """Add the shadow of volumes on surfaces, where it is wanted. Raises Cancelled."""
        if "shadow" in self.wanted:
            with context.report.stage("outputs"):
                self._shadow = surface_shadow(context, scene.sharp, list(surfaces))

    def complete(self, layer: Layer) -> None:
        """Add them to the layer of the whole window."""
        if "deep" in self.wanted:
            parts = [
                (window, tile.image((window[3] - window[1], window[2] - window[0]), self.camera.exposure))
                for window, tile in sorted(self._deep.items())
                if tile is not None
            ]
            layer.deep = DeepImage.joined(self.camera.window, parts)
        if "coverage" in self.wanted:
            layer.coverage = Coverage.joined(self._coverage, self._names)
        layer.shadow = self._shadow
        if self._median is not None:
            total, weight = self._median
            shown = weight > 0.0
            layer.median = np.where(shown, total / np.where(shown, weight, 1.0), np.inf).astype(np.float32)


class PassOutputs:
    """What a pass of colour channels adds to the outputs of a render."""

    def __init__(self, outputs: Outputs, context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass):
        self._outputs, self._context, self._scene, self._pass = outputs, context, scene, channel_pass
        self._weight = len(channel_pass.channels.indices) / 3.0
        self._slicer = DeepSlicer(context, scene, channel_pass) if "deep" in outputs.wanted else None
        media = scene.media(channel_pass.channels, lit=False)
        half = MarchOptions(1, optimizations=context.settings.optimizations, quadrature=_half)
        self._halves = Marcher(media, half, channel_pass.channels.indices, context.tasks.stopping)

    def add(self, tile: Tile, samples: DepthSamples, estimates: Sequence[TileEstimate]) -> None:
        """Add a finished tile. Raises Cancelled."""
        window, outputs = tile.camera.window, self._outputs
        with tile.report.stage("outputs"):
            if self._slicer is not None:
                outputs._deep[window] = self._slicer.add(outputs._deep.get(window), tile, estimates)
            if "coverage" in outputs.wanted:
                outputs._coverage.append(self._coverage(tile, samples))
            if outputs._median is not None:
                self._add_medians(tile, outputs._median)

    def _coverage(self, tile: Tile, samples: DepthSamples) -> Coverage:
        """By each volume, of the pixels of the camera's window."""
        (left, top, right, _), (x0, y0, x1, _) = self._outputs.camera.window, tile.camera.window
        holdout = np.array([medium.holdout for _, medium in self._scene.plan.volumes])
        sample, slot = np.nonzero(samples.fraction > 0.0)
        volume = samples.held[sample, slot].astype(np.int64)
        flat, of = np.unique(samples.pixel[samples.ray[sample]] * len(holdout) + volume, return_inverse=True)
        share = np.bincount(of.reshape(-1), samples.weight[sample] * samples.fraction[sample, slot], len(flat))
        pixels, volumes = np.divmod(flat, len(holdout))
        shown = ~holdout[volumes]
        row, column = np.divmod(pixels[shown], x1 - x0)
        place = (row + y0 - top) * (right - left) + column + x0 - left
        return Coverage(place, volumes[shown], (share[shown] * self._weight).astype(np.float32))

    def _add_medians(self, tile: Tile, image: np.ndarray) -> None:
        """Add the distance at which each ray has half its opacity, times the opacity of the layer."""
        rays = tile_rays(self._context, self._scene.sharp, self._pass, tile.unreported())
        if rays is None:
            return
        (left, top, *_), (x0, y0, x1, y1) = self._outputs.camera.window, tile.camera.window
        sums = np.zeros((2, (y1 - y0) * (x1 - x0)))
        size = max(int(STEPS_PER_TASK / max(self._pass.step_counts(rays.batch).max(), 1)), 1)
        for start in range(0, len(rays.pixel), size):
            self._context.cancel.check()
            some = slice(start, start + size)
            segment = self._halves(rays.batch.take(some).plain())
            weight = segment.alpha * rays.share[some]
            distance = segment.depth.copy()
            distance[segment.sample_ray] = segment.sample_distance
            for row, values in zip(sums, (weight * distance, weight)):
                np.add.at(row, rays.pixel[some], values)
        mean, weight = sums[0] / np.maximum(sums[1], 1e-30), tile.framebuffer.alpha * (sums[1] > 0.0)
        added = np.stack([mean * weight, weight]).astype(np.float32)
        image[:, y0 - top : y1 - top, x0 - left : x1 - left] += added.reshape(2, y1 - y0, x1 - x0)


def _half(count: int) -> tuple[np.ndarray, np.ndarray]:
    """The median of a ray's opacity, as a Quadrature."""
    return np.full(count, 0.5), np.full(count, 1.0 / count)
