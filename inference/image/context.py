# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render holds while it runs."""

import functools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..blur.eyes import Eyes
from ..grids.bound_medium import BoundMedium, Movement
from ..grids.grid import Grid
from ..grids.sun_optical_depth import SunOpticalDepth
from ..marching.extended_lights import ExtendedLights
from ..marching.joined_lamps import PredictedLamp, predicted_lamps
from ..marching.lamp_detail import detail_of_rays
from ..marching.lamp_in_media import LampInMedia
from ..marching.marcher import Marcher
from ..marching.ray_steps import RayBatch, step_counts
from ..network.environment_network import EnvironmentNetwork
from ..network.interfaces import System
from ..network.uncertainty import UncertaintyNetwork
from ..numerics.alike import alike, alike_vector
from ..occluders.depth_buffer import DepthBuffer, EyeDistances
from ..occluders.occluders import Occluders
from ..plan.plan import Channels, Plan
from ..render_cache import RenderCache, ScatteringGroup
from ..runtime.cancellation import CancelToken
from ..runtime.progress import Progress
from ..runtime.report import Report
from ..runtime.tasks import Tasks
from ..scene.camera import Camera
from ..scene.environment import Environment
from ..scene.settings import Settings
from .framebuffer import Framebuffer, Window
from .seen_volumes import SeenVolumes, shown_pixels


@dataclass(frozen=True)
class RenderContext:
    """How a render works, whatever the scene."""

    settings: Settings
    cache: RenderCache
    tasks: Tasks
    progress: Progress
    report: Report

    @property
    def cancel(self) -> CancelToken:
        """Tells whether the caller wants the render to stop."""
        return self.tasks.cancel


@dataclass(frozen=True, kw_only=True)
class PreparedScene:
    """The planned scene as a camera sees it, with everything that does not depend on the colour channel.

    grids: of V volumes. sun_depths: (V, L), of each volume towards each sun of the plan. depth_buffer: of surfaces that
    cover volumes, or None. extended_lights: of the suns with an angular extent, or None. groups: (G,) ScatteringGroups,
    None where nothing is predicted. network: None if nothing is predicted at all. environment_network: that predicts
    the light of environments, or None. uncertainty_network: that tells the network's error, or None. lamps: of the
    plan, with what lies between them and the volumes. open_groups: as groups, without what surfaces hide from the
    middle of the volumes; empty where they hide nothing.
    environments: the plan's, and what surfaces emit and throw back. thrown_back: the one of them that is the latter, or
    None. eyes: that sample the camera's lens, None without one. eye_distances: as of the function of that
    name, of surfaces that cover volumes, or None. motion: as of BoundMedium, of each volume; empty where none moves.
    """

    plan: Plan
    camera: Camera
    grids: list[Grid]
    sun_depths: list[list[SunOpticalDepth]]
    occluders: Occluders
    depth_buffer: DepthBuffer | None
    extended_lights: ExtendedLights | None
    groups: list[ScatteringGroup | None]
    network: System | None = None
    environments: list[Environment] = field(default_factory=list)
    environment_network: EnvironmentNetwork | None = None
    uncertainty_network: UncertaintyNetwork | None = None
    lamps: list[LampInMedia] = field(default_factory=list)
    open_groups: list[ScatteringGroup | None] = field(default_factory=list)
    thrown_back: Environment | None = None
    eyes: Eyes | None = None
    eye_distances: EyeDistances | None = None
    motion: Sequence[Movement | None] = ()

    @property
    def sharp(self) -> "PreparedScene":
        """As the middle of the lens sees it."""
        return self if self.eyes is None else replace(self, eyes=None, eye_distances=None, motion=())

    def opened(self, group: int) -> ScatteringGroup | None:
        """A group without what surfaces hide from the middle of the volumes."""
        return (self.open_groups[group] if self.open_groups else None) or self.groups[group]

    @property
    def lamp_radius(self) -> float:
        """Distance from lamps within which the coarse transport of any group does not tell their light apart."""
        return max((group.predictor.lamp_radius for group in self.groups if group is not None), default=0.0)

    @functools.cached_property
    def lamp_cells(self) -> list[list[int]]:
        """Lamps, by number, that rays gather together: in one cluster of every group, and shadowed or not alike."""
        cells: dict[Hashable, list[int]] = {}
        for k, lamp in enumerate(self.lamps):
            of_groups = [[k in cluster for cluster in clusters].index(True) for clusters in self.plan.lamp_clusters]
            cells.setdefault((lamp.shadow_maps is None, *of_groups), []).append(k)
        return list(cells.values())

    @functools.cached_property
    def marched_lamps(self) -> list[PredictedLamp]:
        """The lamps of each cell, as one lamp."""
        middle = 0.5 * (self.corners.min(axis=0) + self.corners.max(axis=0))
        return predicted_lamps(self.lamps, self.lamp_cells, middle)

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """Corners (8 V, 3) of the volumes in the world."""
        return np.concatenate([grid.corners() for grid in self.grids])

    @property
    def shown(self) -> np.ndarray:
        """bool (rows, columns): pixels of the camera's window in which rays may meet a volume."""
        x0, y0, x1, y1 = self.camera.window
        if "missed_pixels" not in self.plan.optimizations:
            return np.ones((y1 - y0, x1 - x0), bool)
        return self._shown[0]

    @functools.cached_property
    def _shown(self) -> tuple[np.ndarray, np.ndarray]:
        return shown_pixels(self.camera, self.grids, self.eyes, self.motion)

    @functools.cached_property
    def _seen(self) -> SeenVolumes:
        return SeenVolumes(self._shown[1], self.corners, [sun.direction for sun in self.plan.suns])

    @functools.cached_property
    def _group_of(self) -> np.ndarray:
        """int (V,), number of each volume's group."""
        numbers = np.empty(len(self.grids), int)
        for g, members in enumerate(self.plan.groups):
            numbers[members] = g
        return numbers

    def parts(self, window: Window) -> list[tuple[Window, list[int]]]:
        """A window of the image in parts that show few volumes each, with the groups that matter to rays of each part;
        without those to which none does."""
        if len(self.plan.groups) == 1 or "missed_pixels" not in self.plan.optimizations:
            return [(window, list(range(len(self.plan.groups))))]
        parts = [(part, np.unique(self._group_of[self._seen(part)]).tolist()) for part in self._seen.cut(window)]
        return [(part, groups) for part, groups in parts if groups]

    def groups_holding(self, inside: np.ndarray, volumes: Sequence[int]) -> tuple[np.ndarray, list[int]]:
        """What groups of volumes M samples are in, bool (M, G), and the groups' numbers, ascending.

        inside: bool (M, V), the same of the volumes, by number.
        """
        of_volume = self._group_of[volumes]
        numbers = np.unique(of_volume)
        if len(numbers) == len(volumes):
            order = np.argsort(of_volume)
            return inside if (order[:-1] < order[1:]).all() else inside[:, order], numbers.tolist()
        return np.stack([inside[:, of_volume == g].any(axis=1) for g in numbers], axis=1), numbers.tolist()

    def alike(self, channels: Channels) -> list[list[int]]:
        """Groups in which multiple scattering is predicted, those together that differ in where they lie alone."""
        found: dict[Hashable, list[int]] = {}
        for g, _ in self.predicted(channels):
            found.setdefault(self._alike(g, channels), []).append(g)
        return list(found.values())

    def _alike(self, g: int, channels: Channels) -> Hashable:
        """Equal for groups that are alike."""
        group, plan = self.groups[g], self.plan
        assert group is not None
        placed = (
            self.lamps or self.occluders or any(environment.weight is not None for environment in self.environments)
        )
        if placed or len(plan.groups[g]) > 1 or group.volume.scattering is not None:
            return g
        medium, cube = group.medium, group.predictor.cube
        lit = tuple(sun.lights(group.volume.name) for sun in plan.suns)
        sigma_hat = alike(medium.sigma_t[channels.indices[0]] * cube.edge)
        return group.predictor.kind, sigma_hat, alike_vector(cube.rotation.ravel()), medium.albedo.tobytes(), lit

    def predicted(self, channels: Channels) -> list[tuple[int, ScatteringGroup]]:
        """Groups, with their numbers, in which multiple scattering is predicted in some colour channels."""
        return [
            (g, group) for g, group in enumerate(self.groups) if group is not None and self.plan.predicts(g, channels)
        ]

    def media(self, channels: Channels, lit: bool = True) -> list[BoundMedium]:
        """The volumes bound to their grids, their extinction in some colour channels and, where lit, the suns."""
        return [
            BoundMedium(grid, medium, float(sigma_t), depths if lit else [], motion)
            for grid, (_, medium), sigma_t, depths, motion in zip(
                self.grids,
                self.plan.volumes,
                channels.sigma_t,
                self.sun_depths,
                self.motion or [None] * len(self.grids),
            )
        ]


@dataclass(frozen=True)
class ChannelPass:
    """Colour channels that are rendered together.

    media: of each volume, with its extinction in these channels. march: marches camera rays through the media.
    scattering: as in MarchOptions. near: lamps near volumes, whose light needs more depth samples. most_detail: as in
    MarchOptions. groups, volumes: numbers of those that rays are marched through.
    """

    channels: Channels
    media: Sequence[BoundMedium]
    march: Marcher
    scattering: Sequence[int] = (0,)
    near: Sequence[LampInMedia] = ()
    most_detail: int = 1
    groups: Sequence[int] = ()
    volumes: Sequence[int] = ()

    def through(self, groups: Sequence[int]) -> "ChannelPass":
        """The same through some groups of volumes alone, by number; in the light of lamps through all of them."""
        if self.march.has_lamps or len(groups) == len(self.groups):
            return self
        march = self.march.through(groups)
        return replace(self, media=march.media, march=march, groups=groups, volumes=march.volumes)

    @property
    def holdouts(self) -> list[int]:
        """Numbers of the volumes that are holdouts."""
        return [v for v, bound in zip(self.volumes, self.media) if bound.medium.holdout]

    def step_counts(self, rays: RayBatch) -> np.ndarray:
        """As the function of that name."""
        return step_counts(self.march.boxes, rays)

    def detailed(self, rays: RayBatch) -> RayBatch:
        """Rays with as many depth samples as the light of lamps near them needs."""
        return replace(rays, detail=detail_of_rays(self.near, rays, self.most_detail)) if self.near else rays

    def scattering_place(self, channel: int) -> int:
        """Place of a colour channel among those whose scattering is gathered."""
        return self.scattering.index(channel) if len(self.scattering) > 1 else 0


@dataclass(frozen=True)
class Tile:
    """A part of the image that one thread renders: a camera whose region it is, its pixels, and what was done.

    shown: int, ascending numbers of the pixels that may show a volume.
    """

    camera: Camera
    framebuffer: Framebuffer
    report: Report
    shown: np.ndarray

    @classmethod
    def of(cls, camera: Camera, window: Window, shown: np.ndarray) -> "Tile":
        """A black tile; shown: bool (rows, columns), pixels of the camera's window that may show a volume."""
        (left, top, *_), (x0, y0, x1, y1) = camera.window, window
        pixels = np.flatnonzero(shown[y0 - top : y1 - top, x0 - left : x1 - left])
        framebuffer = Framebuffer.black((y1 - y0) * (x1 - x0))
        return cls(replace(camera, region=window), framebuffer, Report.of_thread(), pixels)

    def part(self, window: Window) -> "Tile":
        """The same tile, of which the pixels of a window alone are shown."""
        (left, top, right, _), (x0, y0, x1, y1) = self.camera.window, window
        if window == self.camera.window:
            return self
        rows, columns = np.divmod(self.shown, right - left)
        within = (columns >= x0 - left) & (columns < x1 - left) & (rows >= y0 - top) & (rows < y1 - top)
        return replace(self, shown=self.shown[within])

    def unreported(self) -> "Tile":
        """The same tile with a report of its own, for work on it that is not counted."""
        return replace(self, report=Report.of_thread())
