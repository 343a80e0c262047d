# SPDX-License-Identifier: GPL-3.0-or-later
"""Render settings."""

from dataclasses import dataclass

from .errors import SceneError
from .optimizations import ALL, RETIRED

#: Factors of depth samples on rays that pass lamps near volumes: odd numbers, so that nodes of a quadrature stay in the
#: middle of a stratum.
DETAIL = 1, 3, 5, 9
# Depth samples of a ray above which no detail is added.
ENOUGH = 96

#: Names of what a layer holds on request.
OUTPUTS = frozenset({"deep", "coverage", "median", "shadow"})


@dataclass
class Settings:
    """Render settings.

    depth_samples: network evaluations along a camera ray through an opaque medium, 1 to 512.
    model: name of the network, a file in inference/weights or a registered system.
    seed: of the jitter of lookups; equal seeds give equal images.
    threads: worker threads, 0 for one per core; the image does not depend on it.
    memory_limit: bytes that the render may use on top of its input; a render estimated to need more shows its
        largest volumes at lower resolution, or is refused.
    multiple: whether multiple scattering is predicted; without it the volumes are too dark.
    provider: onnxruntime execution provider that runs the network, a key of `provider.PROVIDERS`.
    light_paths: whether the light of environments is corrected by some ten thousand light paths, where these can be
        followed.
    directional: whether baked light is right from other directions than the camera's too.
    most_voxels: along the longest edge of a baked lattice, whose voxels are joined beyond; 0 for as many as there are.
        The density keeps up to three times as many.
    outputs: what the layer holds besides its colours, of OUTPUTS.
    detail_width: pixels across the picture for which light is resolved, 0 for those of the camera: rough pictures of a
        viewport share the light of the last one.
    blur_rays: rays per pixel that sample the lens, 2 to 256, where the camera has one.
    tolerance: factor, from 1 to 16, of the errors that adaptive interpolation and larger cells of the coarse transport
        may cause.
    states_error: whether the expected error of the layer is computed.
    optimizations: the optimizations in use, names of `optimizations.OPTIMIZATIONS`.

    Raises SceneError for values out of range and unknown names.
    """

    depth_samples: int = 4
    model: str = "mrpnn"
    seed: int = 0
    threads: int = 0
    memory_limit: int = 8 << 30
    multiple: bool = True
    provider: str = "CPU"
    light_paths: bool = True
    directional: bool = True
    most_voxels: int = 0
    optimizations: frozenset[str] = ALL
    outputs: frozenset[str] = frozenset()
    blur_rays: int = 4
    detail_width: int = 0
    tolerance: float = 1.0
    states_error: bool = True

    def __post_init__(self) -> None:
        for name, least, most in (
            ("depth samples", 1, 512),
            ("blur rays", 2, 256),
            ("threads", 0, 1024),
            ("seed", 0, 2**63 - 1),
            ("most voxels", 0, 2**31),
            ("detail width", 0, 2**31),
        ):
            value = getattr(self, name.replace(" ", "_"))
            if not least <= value <= most or value != int(value):
                raise SceneError(f"{name} must be a whole number from {least} to {most}, not {value}")
        self.optimizations = frozenset(self.optimizations) - set(RETIRED.values())
        unknown = sorted(self.optimizations - ALL)
        if unknown:
            raise SceneError(f"there is no optimization called {unknown[0]!r}; there are: {', '.join(sorted(ALL))}")
        if not self.outputs <= OUTPUTS:
            raise SceneError(
                f"outputs must be among {', '.join(sorted(OUTPUTS))}, not {', '.join(sorted(self.outputs))}"
            )
        if not 1.0 <= self.tolerance <= 16.0:
            raise SceneError(f"the tolerance must be from 1 to 16, not {self.tolerance}")
        if not self.memory_limit > 0:
            raise SceneError(f"the memory limit must be above 0, not {self.memory_limit}")

    @property
    def most_detail(self) -> int:
        """The largest of DETAIL that is used."""
        return max(factor for factor in DETAIL if factor == 1 or factor * self.depth_samples <= ENOUGH)
