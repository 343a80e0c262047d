# SPDX-License-Identifier: GPL-3.0-or-later
"""Small renders against double precision: alpha and single scattering, which hold nothing learned."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from inference import Camera, Medium, Settings, Sun, Volume, render
from inference.network.baselines import SINGLE, register_baselines
from inference.scene.camera_rays import camera_rays
from inference.scene.phase_function import henyey_greenstein

from .case import Case, Outcome, unsound
from .exact import exact_view
from .scenes import SUN, camera, placed

BOUNDS = {"alpha": 2e-3, "single": 0.05, "bias": 0.02}
# Views darker than this share of what lit fog would show are measured against that share.
DARK = 0.01


register_baselines()


@dataclass(frozen=True)
class RenderSpec:
    """One volume in one view.

    volume: a Volume, a density (nx, ny, nz), which then fills a unit cube, or () -> Volume. view: the usual camera
    where there is none. visible: the part of the volume that the view shows and that lies towards the suns, where that
    is not all of it.
    """

    volume: Volume | np.ndarray | Callable[[], Volume]
    sigma_t: float = 10.0
    view: Camera | None = None
    suns: Sequence[Sun] = (SUN,)
    anisotropy: float = 0.0
    albedo: float = 0.5
    visible: Volume | None = None

    def placed_volume(self) -> Volume:
        if callable(self.volume):
            return self.volume()
        return self.volume if isinstance(self.volume, Volume) else placed(self.volume)

    def exact(self, volume: Volume, view: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Alpha (R,), single scattering (R,) and single scattering without shadows (R,), in double precision."""
        alpha, transmittance = exact_view(self.visible or volume, self.sigma_t, self.suns, view)
        cosine = camera_rays(view)[1] @ np.array([sun.direction for sun in self.suns]).T
        phase = self.albedo * henyey_greenstein(cosine, self.anisotropy)
        scattered = phase * [sun.irradiance[0] for sun in self.suns]
        return alpha, (transmittance * scattered).sum(axis=1), (alpha[:, None] * scattered).sum(axis=1)


def render_case(group: str, name: str, spec: RenderSpec, quick: bool = False, **bounds) -> Case:
    """A case of one render.

    Quantities: alpha, the largest difference; single, the root mean square relative to the mean; bias of the sum. A
    bound of None leaves one out.
    """

    def measure():
        volume, view = spec.placed_volume(), spec.view or camera()
        medium = Medium(spec.sigma_t, spec.albedo, spec.anisotropy)
        layer = render([(volume, medium)], list(spec.suns), view, Settings(1, SINGLE))
        alpha, truth, unshadowed = spec.exact(volume, view)
        single = layer.single[..., 0].ravel().astype(np.float64)
        mean = max(truth.mean(), DARK * unshadowed.mean(), 1e-30)
        return Outcome(
            {
                "unsound": unsound(layer),
                "alpha": float(np.abs(layer.alpha.ravel() - alpha).max()),
                "single": float(np.sqrt(((single - truth) ** 2).mean()) / mean),
                "bias": float(abs(single.mean() - truth.mean()) / mean),
            },
            layer.single / max(layer.single.max(), 1e-30),
        )

    bounds = {"unsound": 0.0, **BOUNDS, **bounds}
    return Case(
        group,
        name,
        "double precision",
        measure,
        {quantity: bound for quantity, bound in bounds.items() if bound is not None},
        quick,
    )
