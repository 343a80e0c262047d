# SPDX-License-Identifier: GPL-3.0-or-later
"""Options and results of marching camera rays.

The light of a lamp near a ray varies within a step as the inverse square of its distance. Its integral over each step
is a quadrature in the angle under which the lamp sees the step, in which the inverse square is constant (Kulla and
Fajardo, "Importance Sampling Techniques for Path Tracing in Participating Media", 2012); the transmittance varies
exponentially within a step, as for suns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..occluders.shadow_map import ShadowMap
from ..scene.optimizations import ALL
from ..transport.scattered_fluence import ScatteredFluence
from .depth_samples import Quadrature, gauss_legendre
from .joined_lamps import PredictedLamp
from .mean_lamp_depth import MeanLampDepth
from .ray_features import REACH, RayFeatures

# Optical depth up to which rays are marched for single scattering: a fraction of 1e-6 is transmitted.
MAX_OPTICAL_DEPTH = 14.0
# Jitter of fluence lookups, in cells: a rank-1 lattice over the steps of a ray.
JITTER = np.array([[0.8191725], [0.6710436], [0.5497005]], np.float32)
# Optical depth that counts as complete shadow.
DARK = np.float32(60.0)
# Length of a step over its distance to a lamp from which on it takes MANY nodes, in the angle under which the lamp sees
# it, instead of FEW in its length; and up to which a single node in its middle is enough.
WIDE, FEW, MANY, BRIEF = 0.2, 2, 10, 0.02


@dataclass(frozen=True)
class MarchOptions:
    """What is gathered along rays.

    depth_samples: of an opaque ray. fluence: ScatteredFluence per group of volumes, None for a group without
    prediction; None altogether if no ray features are wanted. shadow_maps: of each sun, or None if no surface shadows
    volumes. groups: numbers of the volumes that the network treats as one medium, each alone if None. optimizations:
    those in use, as in Settings. quadrature: where depth samples lie in a ray's opacity. scattering: colour channels
    whose scattering is gathered, by number; a single channel unless an albedo varies in colour. most_detail: largest of
    RayBatch.detail. at_start: each ray has one depth sample, where it begins, in density or not. suns: (L, 3), unit
    vectors towards the suns, which rays use to pass by volumes far away; None if that is not wanted.
    """

    depth_samples: int
    fluence: list[ScatteredFluence | None] | None = None
    shadow_maps: list[ShadowMap] | None = None
    groups: list[list[int]] | None = None
    optimizations: frozenset[str] = ALL
    quadrature: Quadrature = gauss_legendre
    scattering: Sequence[int] = (0,)
    most_detail: int = 1
    at_start: bool = False
    suns: np.ndarray | None = None


@dataclass(frozen=True)
class LampSegment:
    """What a batch of R rays gathered of K lamps of power 1 in V volumes.

    single: (R, V, K, S), single scattering as in RaySegment. features: RayFeatures of samples for each lamp's light
    over its softened fluence there, or None.
    """

    single: np.ndarray
    features: RayFeatures | None = None


@dataclass(frozen=True)
class RaySegment:
    """What a batch of R rays gathered of V volumes and L suns.

    alpha: (R,). depth: (R,), mean scattering distance. optical_depth: (R, V) of each volume, up to where the ray is
    opaque. single: (R, V, L, S), single scattering for irradiance 1 and phase function 1, in the S colour channels of
    `MarchOptions.scattering`, for albedo 1 except in volumes whose albedo varies. sample_ray: int (M,), ray of each
    depth sample. sample_distance: (M,). sample_weight: (M,), sums to alpha over the samples of a ray. sample_fraction:
    (M, V), of the extinction there in each volume. sample_features: RayFeatures of the samples, or None.
    steps_evaluated: number of steps, of all rays. emission: (R, C) of the colour channels asked for, or None where no
    volume emits light. lamps: LampSegment, or None. sample_scattering: float32 (M, V, S), scattering of each volume
    over the extinction of all, for albedo 1 as in `single`; scattering_depth: (R, V, S), as optical_depth, of
    scattering; both None where no albedo varies.
    """

    alpha: np.ndarray
    depth: np.ndarray
    optical_depth: np.ndarray
    single: np.ndarray
    sample_ray: np.ndarray
    sample_distance: np.ndarray
    sample_weight: np.ndarray
    sample_fraction: np.ndarray
    sample_features: RayFeatures | None = None
    steps_evaluated: int = 0
    emission: np.ndarray | None = None
    lamps: LampSegment | None = None
    sample_scattering: np.ndarray | None = None
    scattering_depth: np.ndarray | None = None


@dataclass(frozen=True)
class LampMarch:
    """Lamps whose light is gathered along camera rays.

    fluence: scattered light of the lamps in each group of volumes, None for a group without prediction; None altogether
    if no ray features are wanted. radius: by which `softened` limits their light for these. means: mean optical depth
    of each lamp's light, or None; only for a single volume that no surface shadows from the lamp.
    """

    lamps: Sequence[PredictedLamp]
    fluence: list[ScatteredFluence | None] | None
    radius: float
    means: Sequence[MeanLampDepth | None] = ()

    def mean(self, number: int) -> MeanLampDepth | None:
        """Mean depth of a lamp's light, by the lamp's number, or None."""
        return self.means[number] if self.means else None


def optical_depth_behind(options: MarchOptions) -> float:
    """Optical depth up to which rays are marched."""
    if "behind_opaque" not in options.optimizations:
        return np.inf
    return MAX_OPTICAL_DEPTH if options.fluence is None else REACH
