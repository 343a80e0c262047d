"""What a layer and a Cycles reference of the same view have to say about each other."""

from dataclasses import asdict, dataclass, field
from typing import List, Tuple

import numpy as np

from ..inference.error import Estimate, paper_metric, relative_bias, relative_rmse
from ..inference.layer import Layer
from ..inference.scene import SceneError
from .cycles_reference import Reference
from .json_file import write_json

# Below this alpha a pixel holds so little of the volume that ratios are noise.
MASK_ALPHA = 0.02


@dataclass
class Comparison:
    """rmse, bias, alpha_bias: relative, with 95 % intervals, over the pixels of alpha above MASK_ALPHA.
    paper: the paper's metric over the whole image.
    noise: the reference's own relative standard deviation a pixel, both halves together.
    layer_seconds, cycles_seconds: wall clock; Cycles' for both halves.
    resolution: (width, height). pixels: how many the mask holds.
    samples: a pixel in each half. bounces: most scattering events. cycles: Blender's version.
    warnings: what the layer leaves out.
    """

    rmse: Estimate
    bias: Estimate
    alpha_bias: Estimate
    paper: float
    noise: float
    layer_seconds: float
    cycles_seconds: float
    resolution: Tuple[int, int]
    pixels: int
    samples: int
    bounces: int
    cycles: str
    warnings: List[str] = field(default_factory=list)

    def table(self) -> str:
        """The figures as lines of text."""
        rows = [
            ("relative RMSE", f"{self.rmse.value:8.3f}", _interval(self.rmse, "{:.3f}")),
            ("relative bias", f"{100 * self.bias.value:+7.1f} %", _interval(self.bias, "{:+.1f} %", 100)),
            ("alpha bias", f"{100 * self.alpha_bias.value:+7.2f} %", _interval(self.alpha_bias, "{:+.2f} %", 100)),
            ("paper's metric", f"{self.paper:8.2f}", ""),
            ("seconds, layer", f"{self.layer_seconds:8.1f}", ""),
            ("seconds, Cycles", f"{self.cycles_seconds:8.1f}",
             f"2 x {self.samples} samples, {self.bounces} bounces, noise left {self.noise:.2f}"),
        ]
        width, height = self.resolution
        head = f"Layer against Cycles {self.cycles}: {width} x {height}, {self.pixels} pixels show the volume"
        return "\n".join([head] + [f"  {name:<16}{value:<10} {note}".rstrip() for name, value, note in rows])

    def write_json(self, path: str) -> None:
        """All figures to `path`, which is replaced in one step."""
        write_json(path, asdict(self))


def compare(layer: Layer, layer_seconds: float, reference: Reference, warnings=()) -> Comparison:
    """Measure `layer` against the two halves of `reference`.

    Raises SceneError where the two differ in size, the volume is nowhere in view, or the reference
    is black.
    """
    a, b = reference.a, reference.b
    if a.shape[:2] != layer.alpha.shape:
        raise SceneError(f"the layer has {_size(layer.alpha)} pixels and Cycles' image {_size(a)}")
    mask = layer.alpha > MASK_ALPHA
    try:
        bias = relative_bias(layer.rgb, a[..., :3], b[..., :3], mask)
    except ValueError as error:
        raise SceneError(f"nothing to compare: {error}") from None
    mean = ((a + b) / 2)[mask][:, :3].mean()
    height, width = mask.shape
    return Comparison(
        rmse=relative_rmse(layer.rgb, a[..., :3], b[..., :3], mask),
        bias=bias,
        alpha_bias=relative_bias(layer.alpha, a[..., 3], b[..., 3], mask),
        paper=paper_metric(layer.rgb, a[..., :3], b[..., :3]),
        # Half the difference of two independent halves varies as their mean does.
        noise=float(np.sqrt(np.mean(((a - b) / 2)[mask][:, :3] ** 2)) / mean),
        layer_seconds=layer_seconds, cycles_seconds=reference.seconds,
        resolution=(width, height), pixels=int(mask.sum()),
        samples=reference.samples, bounces=reference.bounces, cycles=reference.version,
        warnings=list(warnings),
    )


def _interval(estimate: Estimate, form: str, scale: float = 1.0) -> str:
    low, high = (form.format(scale * edge) for edge in (estimate.low, estimate.high))
    return f"95 % between {low} and {high}"


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
