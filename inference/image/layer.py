# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of a render."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..deep.deep_image import DeepImage
from ..runtime.report import Report
from ..scene.camera import Camera
from .framebuffer import Framebuffer


@dataclass
class Coverage:
    """How much of the opacity of pixels each volume has, where it has any.

    pixel: int (N,), numbers of the layer's pixels, row by row, ascending. volume: int (N,), whose name is in `names`.
    share: float32 (N,), of the pixel; together they are its alpha.
    """

    pixel: np.ndarray
    volume: np.ndarray
    share: np.ndarray
    names: Sequence[str] = ()

    @classmethod
    def joined(cls, parts: Sequence["Coverage"], names: Sequence[str]) -> "Coverage":
        """What parts tell together, which may be of the same pixels and volumes; names: of the volumes of all."""
        pixel, volume, share = (
            np.concatenate([np.zeros(0, kind), *(getattr(part, name) for part in parts)])
            for name, kind in (("pixel", np.int64), ("volume", np.int64), ("share", np.float32))
        )
        count = int(volume.max(initial=0)) + 1
        flat, of = np.unique(pixel * count + volume, return_inverse=True)
        share = np.bincount(of.reshape(-1), share, len(flat)).astype(np.float32)
        return cls(flat // count, flat % count, share, names)


@dataclass
class Layer:
    """The image layer that a render returns, rows from the top.

    rgb: float32 (H, W, 3), linear radiance times the camera's exposure, premultiplied by alpha.
    alpha: float32 (H, W), 1 - transmittance of the camera ray.
    depth: float32 (H, W), mean distance along the ray at which light scatters, world units; infinity where alpha is 0.
    single, multiple, emission: float32 (H, W, 3), single scattering, multiple scattering, and emission that is not
        scattered; rgb is their sum.
    uncertainty: float32 (H, W), standard deviation of the error, mean over the channels: of what predicts `multiple`
        and the light of environments, and of depth sampling and interpolation between pixels. With one depth sample it
        is at least as large as `multiple`. The error of systems that `predicted_error` knows none of is left out.
    groups: float32 (H, W, 3), shares of rgb by the name of each group of lights; empty where none are asked for.
    report: what was planned, skipped and measured; None for a tile.
    sampling_error: float32 (H, W), the part of the uncertainty due to depth sampling and interpolation, which more
        depth samples lower; None where it is not kept.
    deep, coverage, median, shadow: on request (`Settings.outputs`), else None. deep: samples that are the layer when
        they are flattened. median: float32 (H, W), distance along the ray at which half of the opacity is in front;
        infinity where alpha is 0. shadow: float32 (H, W, 3), share of the light of suns and lamps that volumes let
        through to the surface of the pixel; 1 without one.
    passes: float32 (H, W) or (H, W, channels), more of them by name, which whoever asked for the layer has added.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    single: np.ndarray
    multiple: np.ndarray
    uncertainty: np.ndarray
    emission: np.ndarray
    report: Report | None = None
    sampling_error: np.ndarray | None = None
    groups: dict[str, np.ndarray] = field(default_factory=dict)
    deep: DeepImage | None = None
    coverage: Coverage | None = None
    median: np.ndarray | None = None
    shadow: np.ndarray | None = None
    passes: dict[str, np.ndarray] = field(default_factory=dict)


def compose_layer(
    framebuffer: Framebuffer, shape: tuple[int, int], exposure: float = 1.0, report: Report | None = None
) -> Layer:
    """The Layer of a framebuffer's pixels, in its memory, so that it cannot be added to any more.

    shape: (H, W). exposure: of the camera.
    """
    if exposure != 1.0:
        for radiance in framebuffer.radiances():
            radiance *= np.float32(exposure)
    single, multiple, emission = (
        colour.reshape(*shape, 3) for colour in (framebuffer.single, framebuffer.multiple, framebuffer.emission)
    )
    alpha, depth, uncertainty = framebuffer.alpha, framebuffer.depth, framebuffer.deviation
    shown = alpha > 0.0
    np.divide(depth, alpha, out=depth, where=shown)
    depth[~shown] = np.inf
    np.clip(alpha, 0.0, 1.0, out=alpha)
    np.hypot(framebuffer.uncertainty, uncertainty, out=uncertainty)
    rgb = single + multiple
    rgb += emission
    return Layer(
        rgb=rgb,
        alpha=alpha.reshape(shape),
        depth=depth.reshape(shape),
        single=single,
        multiple=multiple,
        uncertainty=uncertainty.reshape(shape),
        emission=emission,
        report=report,
        sampling_error=framebuffer.uncertainty.reshape(shape),
    )


def empty_layer(camera: Camera, outputs: frozenset[str] = frozenset()) -> Layer:
    """The layer of a camera that sees no volume; outputs: as of Settings."""
    x0, y0, x1, y1 = camera.window
    framebuffer = Framebuffer.black((y1 - y0) * (x1 - x0))
    layer = compose_layer(framebuffer, (y1 - y0, x1 - x0), report=Report(seconds={"total": 0.0}))
    layer.deep = DeepImage.empty((y1 - y0, x1 - x0)) if "deep" in outputs else None
    layer.coverage = Coverage.joined([], []) if "coverage" in outputs else None
    layer.median = layer.depth.copy() if "median" in outputs else None
    layer.shadow = np.ones((y1 - y0, x1 - x0, 3), np.float32) if "shadow" in outputs else None
    return layer
