# SPDX-License-Identifier: GPL-3.0-or-later
"""Deep samples, mattes and the median's depth of extreme scenes."""

import numpy as np

from inference import Medium, Settings, render
from inference.scene.settings import OUTPUTS

from .case import Case, Outcome, unsound
from .densities import one_dense_voxel
from .scenes import SUN, blob, camera, placed

# Half precision, in which deep files hold colours.
HALF = 2.0**-10


def layer_case(name: str, density: np.ndarray, thickness: float, view=None, quick: bool = False) -> Case:
    """Samples that flatten to the layer, coverage that adds up to its alpha; thickness: optical, of a unit length."""

    def measure():
        volume, settings = placed(density), Settings(4, outputs=OUTPUTS)
        layer = render([(volume, Medium(thickness, 0.95, 0.5))], [SUN], view or camera(pixels=12), settings)
        deep, bright = layer.deep, max(float(layer.rgb.max()), 1e-30)
        flat = deep.flat()
        mattes = np.bincount(layer.coverage.pixel, layer.coverage.share, layer.alpha.size).reshape(layer.alpha.shape)
        wrong = ~np.isfinite(deep.rgba).all(axis=1) | (deep.rgba < 0.0).any(axis=1) | (deep.rgba[:, 3] > 1.0)
        wrong |= ~np.isfinite(deep.front) | ~(deep.back >= deep.front)
        return Outcome(
            {
                "unsound": unsound(layer) + float(wrong.sum()),
                "flat colour": float(np.abs(flat[..., :3] - layer.rgb).max() / bright),
                "flat alpha": float(np.abs(flat[..., 3] - layer.alpha).max()),
                "mattes": float(np.abs(mattes - layer.alpha).max()),
                "median": float((~np.isfinite(layer.median) & (layer.alpha > 0.0)).sum()),
                "samples": float(deep.counts.max(initial=0)),
            }
        )

    bounds = {"unsound": 0.0, "flat colour": HALF, "flat alpha": HALF, "mattes": HALF, "median": 0.0, "samples": 64.0}
    return Case("deep samples", name, "the layer", measure, bounds, quick)


CASES = [
    *(layer_case(f"σ̂ = {s:g}", blob(), s, quick=s in (1e-6, 1e7)) for s in (1e-6, 1e-3, 1.0, 1e3, 1e7)),
    layer_case("one voxel a million times denser", one_dense_voxel(), 1e5),
    layer_case("the camera in the middle, σ̂ = 1000", blob(), 1e3, camera((0.01, 0.02, 0.03), pixels=12)),
    layer_case(
        "no volume in sight", blob(), 10.0, camera((0.0, 0.0, 9.0), target=(0.0, 0.0, 99.0), pixels=4), quick=True
    ),
]
