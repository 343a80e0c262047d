# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of lamps, and their shadows, as the structures that compiled kernels read."""

import numpy as np

from ..kernels import structures
from ..occluders.lamp_shadow_map import LampShadowMap
from ..scene.emitters import CLOSEST, FULL_SPREAD, Emitter, SphereEmitter
from ..scene.spot_cone import SpotCone


def describe_emitter(emitter: Emitter) -> structures.Shared:
    """A part of a lamp."""
    common = dict(position=np.float64(emitter.position), extent=float(emitter.extent))
    if isinstance(emitter, SphereEmitter):
        cone = emitter.cone or SpotCone(np.zeros(3), -1.0)
        return structures.Emitter(
            flat=0,
            centre=np.float64(emitter.centre),
            radius=emitter.radius,
            intensity=emitter.share / (4.0 * np.pi),
            closest=CLOSEST * float(np.abs(emitter.centre).max(initial=1e-3)) ** 2,
            soft_falloff=emitter.soft_falloff,
            cone=emitter.cone is not None,
            axis=np.float64(cone.axis),
            cosine=cone.cosine,
            width=cone.width,
            bound=cone.bound,
            elliptic=cone.frame is not None,
            frame=np.zeros((3, 3)) if cone.frame is None else cone.frame,
            stretch=cone.stretch,
            **common,
        )
    half = max(0.5 * emitter.spread, 1e-4)
    diffuse = emitter.spread >= FULL_SPREAD
    nodes, areas = emitter.nodes
    tangent, focused = float(np.tan(half)), float(np.tan(half) - half)
    return structures.Emitter(
        flat=1,
        corners=np.float64(emitter.corners),
        normal=np.float64(emitter.normal),
        radiance=emitter.radiance,
        area=emitter.area,
        nodes=np.float64(nodes),
        areas=np.float64(areas),
        far=emitter.far,
        tangent=0.0 if diffuse else tangent,
        focus=1.0 if diffuse else tangent / focused,
        focused=1.0 if diffuse else focused,
        **common,
    )


def describe_shadow_map(shadow_map: LampShadowMap) -> structures.Shared:
    """Distances of the surfaces around a part of a lamp."""
    return structures.LampShadowMap(
        distances=np.ascontiguousarray(shadow_map.distances, np.float32),
        extremes=shadow_map.extremes,
        cells=shadow_map.distances.shape[1],
        blocks=shadow_map.extremes.shape[1],
        position=shadow_map.position,
        frames=np.stack(shadow_map.frames),
    )
