# SPDX-License-Identifier: GPL-3.0-or-later
"""Deep samples, mattes and the median's depth of extreme scenes, and extreme lenses and motion."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from inference import Camera, Lens, Medium, Settings, Shutter, Velocity, Volume, render
from inference.scene.settings import OUTPUTS

from .case import Case, Outcome, unsound
from .densities import one_dense_voxel
from .scenes import SUN, blob, camera, moved, placed

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


def blur_case(
    name: str, against: str, view: Camera, volume: Volume, thickness: float, alpha: Callable, quick: bool = False
) -> Case:
    """A blurred picture whose alpha is known; alpha: () -> that, (H, W). thickness: optical, of a unit length."""

    def measure():
        layer = render([(volume, Medium(thickness, 0.95, 0.5))], [SUN], view, Settings(4))
        apart = np.abs(layer.alpha - alpha()).max()
        return Outcome({"unsound": unsound(layer), "alpha": float(apart)}, layer.rgb / max(layer.rgb.max(), 1e-30))

    return Case("blur", name, against, measure, {"unsound": 0.0, "alpha": 0.04}, quick)


def sharp(view: Camera, volume: Volume, thickness: float) -> np.ndarray:
    """Alpha (H, W) without lens and shutter, means over the pixels' areas."""
    width, height = view.resolution
    fine = replace(view, lens=None, shutter=None, resolution=(8 * width, 8 * height))
    alpha = render([(volume, Medium(thickness))], [], fine, Settings(4)).alpha
    return alpha.reshape(height, 8, width, 8).mean(axis=(1, 3))


def flowing(size: float, speed: float, times: tuple[float, float]) -> Volume:
    """A lumpy volume that flows along x; size: of the velocity grid. speed: voxels per unit of time."""
    still = placed(blob())
    place = moved(still, np.diag([size] * 3 + [1.0])).world_from_index
    parts = tuple(np.full(still.density.shape, value, np.float32) for value in (1.0, 0.0, 0.0))
    turn = np.eye(3) * (speed * still.world_from_index[0, 0])
    return replace(still, velocity=Velocity(parts, place, turn, times))


def blur_cases() -> list[Case]:
    """Lenses and velocities far from what cameras and simulations have."""
    whole, around, fast = camera(pixels=12), camera((0.01, 0.02, 0.03), pixels=8), flowing(1.0, 1e6, (0.1, 1.0))
    fog, away = placed(np.ones((8, 8, 8))), flowing(1e8, 1e6, (0.1, 1.0))
    moving, tiny = replace(whole, shutter=Shutter()), replace(whole, lens=Lens(1e-9, 3.0))
    still = flowing(1.0, 1e-9, (-0.5, 0.5))
    return [
        blur_case("an aperture of 1e-9", "no blur", tiny, still, 10.0, lambda: sharp(whole, still, 10.0)),
        *(
            blur_case(
                f"inside smoke of σ̂ = {sigma:g}, in focus at {focus:g}",
                "closed form",
                replace(around, lens=Lens(0.02, focus)),
                fog,
                sigma,
                lambda: np.ones((8, 8)),
                quick=sigma == 1e7,
            )
            for sigma, focus in ((1e4, 0.1), (1e7, 0.1), (1e4, 1e-6), (1e4, 1e9))
        ),
        blur_case(
            "an aperture of a million", "closed form", replace(whole, lens=Lens(1e6, 1.0)), fog, 10.0,
            lambda: np.zeros((12, 12)),
        ),
        blur_case("1e-9 voxels per frame", "no blur", moving, still, 10.0, lambda: sharp(whole, still, 10.0)),
        # Where the velocity leads back to, there is none.
        blur_case(
            "a million voxels per frame within the volume", "no blur", moving, fast, 10.0,
            lambda: sharp(whole, fast, 10.0), quick=True,
        ),
        blur_case(
            "a million voxels per frame everywhere", "closed form", moving, away, 10.0, lambda: np.zeros((12, 12))
        ),
    ]  # fmt: skip


CASES = [
    *blur_cases(),
    *(layer_case(f"σ̂ = {s:g}", blob(), s, quick=s in (1e-6, 1e7)) for s in (1e-6, 1e-3, 1.0, 1e3, 1e7)),
    layer_case("one voxel a million times denser", one_dense_voxel(), 1e5),
    layer_case("the camera in the middle, σ̂ = 1000", blob(), 1e3, camera((0.01, 0.02, 0.03), pixels=12)),
    layer_case(
        "no volume in sight", blob(), 10.0, camera((0.0, 0.0, 9.0), target=(0.0, 0.0, 99.0), pixels=4), quick=True
    ),
]
