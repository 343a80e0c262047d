"""Small renders against double precision: shape and single scattering, which hold nothing learned."""

import numpy as np

from inference import Medium, Settings, render
from inference.network.baselines import SINGLE, register_baselines
from inference.scene.phase_function import henyey_greenstein
from inference.scene.camera_rays import camera_rays

from .case import Case, Outcome, unsound
from .exact import exact_view
from .scenes import SUN, camera, placed

BOUNDS = {"alpha": 2e-3, "single": 0.05, "bias": 0.02}
# Views darker than this share of what lit fog would show are measured against that share.
DARK = 0.01


register_baselines()


def shot(group, name, volume, sigma_t=10.0, view=None, suns=(SUN,), anisotropy=0.0, albedo=0.5, quick=False, seen=None,
         **bounds):
    """A case of one volume (or a density, which then fills a unit cube, or what makes the volume) in one view. seen: what
    of it the view shows and lies towards the suns, where that is not all.

    Quantities: alpha, the largest difference; single, the root mean square relative to the mean; bias of the sum. A
    bound of None leaves one out.
    """
    volume = volume if hasattr(volume, "density") or callable(volume) else placed(volume)
    view = view or camera()

    def measure():
        shown = volume() if callable(volume) else volume
        layer = render([(shown, Medium(sigma_t, albedo, anisotropy))], list(suns), view, Settings(1, SINGLE))
        alpha, through = exact_view(seen or shown, sigma_t, suns, view)
        cosine = camera_rays(view)[1] @ np.array([sun.direction for sun in suns]).T
        phase = albedo * henyey_greenstein(cosine, anisotropy) * [sun.irradiance[0] for sun in suns]
        truth = (through * phase).sum(axis=1)
        lit = (alpha[:, None] * phase).sum(axis=1).mean()
        single = layer.single[..., 0].ravel().astype(np.float64)
        mean = max(truth.mean(), DARK * lit, 1e-30)
        return Outcome(
            {"unsound": unsound(layer), "alpha": float(np.abs(layer.alpha.ravel() - alpha).max()),
             "single": float(np.sqrt(((single - truth) ** 2).mean()) / mean),
             "bias": float(abs(single.mean() - truth.mean()) / mean)},
            layer.single / max(layer.single.max(), 1e-30))

    bounds = {"unsound": 0.0, **BOUNDS, **bounds}
    return Case(group, name, "double precision", measure,
                {quantity: bound for quantity, bound in bounds.items() if bound is not None}, quick)
