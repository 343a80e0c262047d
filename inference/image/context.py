# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render holds while it runs."""

from dataclasses import dataclass, replace

from ..grids.bound_medium import BoundMedium
from ..grids.grid import Grid
from ..grids.sun_optical_depth import SunOpticalDepth
from ..kernels.library import Kernels
from ..marching.extended_lights import ExtendedLights
from ..marching.marcher import Marcher
from ..network.environment_network import EnvironmentNetwork
from ..network.interfaces import System
from ..occluders.depth_buffer import DepthBuffer
from ..occluders.occluders import Occluders
from ..plan.plan import Channels, Plan
from ..render_cache import RenderCache, ScatteringGroup
from ..runtime.cancellation import CancelToken
from ..runtime.progress import Progress
from ..runtime.report import Report
from ..runtime.tasks import Tasks
from ..scene.camera import Camera
from ..scene.settings import Settings
from ..transport.scattered_fluence import ScatteredFluence
from .framebuffer import Framebuffer


@dataclass(frozen=True)
class RenderContext:
    """How a render works, whatever the scene.

    kernels: compiled kernels, or None where numpy does the work.
    """

    settings: Settings
    cache: RenderCache
    tasks: Tasks
    progress: Progress
    report: Report
    kernels: Kernels | None = None

    @property
    def cancel(self) -> CancelToken:
        """Tells whether the caller wants the render to stop."""
        return self.tasks.cancel


@dataclass(frozen=True)
class PreparedScene:
    """The planned scene, with everything that does not depend on the colour channel.

    grids: of V volumes. sun_depths: (V, L), of each volume towards each sun of the plan. depth_buffer: of surfaces that
    cover volumes, or None. extended_lights: of the suns with an angular extent, or None. groups: (G,) ScatteringGroups,
    None where nothing is predicted. network: None if nothing is predicted at all. environment_network: that predicts
    the light of environments, or None.
    """

    plan: Plan
    grids: list[Grid]
    sun_depths: list[list[SunOpticalDepth]]
    occluders: Occluders
    depth_buffer: DepthBuffer | None
    extended_lights: ExtendedLights | None
    groups: list[ScatteringGroup | None]
    network: System | None = None
    environment_network: EnvironmentNetwork | None = None

    def predicted(self, channels: Channels) -> list[tuple[int, ScatteringGroup]]:
        """Groups, with their numbers, in which multiple scattering is predicted in some colour channels."""
        return [
            (g, group) for g, group in enumerate(self.groups) if group is not None and self.plan.predicts(g, channels)
        ]

    def media(self, channels: Channels) -> list[BoundMedium]:
        """The volumes bound to their grids and to their extinction in some colour channels."""
        return [
            BoundMedium(grid, medium, float(sigma_t), depths)
            for grid, (_, medium), sigma_t, depths in zip(
                self.grids, self.plan.volumes, channels.sigma_t, self.sun_depths
            )
        ]


@dataclass(frozen=True)
class ChannelPass:
    """Colour channels that are rendered together.

    media: of each volume, with its extinction in these channels. fluence: of each group, None for groups without
    prediction; None altogether for networks that need no ray features. march: marches camera rays through the media.
    """

    channels: Channels
    media: list[BoundMedium]
    fluence: list[ScatteredFluence | None] | None
    march: Marcher


@dataclass(frozen=True)
class Tile:
    """Rows of the image that are rendered together: a camera whose region they are, and their pixels."""

    camera: Camera
    framebuffer: Framebuffer


def make_tiles(plan: Plan, camera: Camera, framebuffer: Framebuffer) -> list[Tile]:
    """The plan's tiles, each sharing memory with the framebuffer."""
    x0, y0, x1, _ = camera.window
    width = x1 - x0
    return [
        Tile(
            replace(camera, region=(x0, top, x1, bottom)),
            framebuffer.part(slice((top - y0) * width, (bottom - y0) * width)),
        )
        for top, bottom in plan.tiles
    ]
