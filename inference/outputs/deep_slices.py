# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays cut into slices, and the light and the opacity that each adds to its pixel: deep images.

Rays are cut where their opacity is a multiple of a share of the whole, and evenly. Single scattering and emission are
marched through each slice by itself. Light that depth samples tell becomes a polynomial in the opacity of the volumes
that scatter it. At last the slices of a pixel are scaled to what the layer shows there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..deep.deep_image import DeepImage
from ..deep.thinning import thinned
from ..grids.bound_medium import BoundMedium
from ..image.camera_pass import STEPS_PER_TASK, MarchedRays, Shading, TileRays, add_lamps, add_marched, tile_rays
from ..image.context import ChannelPass, PreparedScene, RenderContext, Tile
from ..image.framebuffer import Framebuffer
from ..image.tile_estimate import TileEstimate
from ..marching.marcher import Marcher
from ..marching.ray_march import MarchOptions, RaySegment
from ..marching.ray_steps import RayBatch, step_counts
from ..numerics.quadrature import legendre_integrals
from ..scene.camera_rays import viewing_cosine

# Cuts of an opaque ray by opacity, and evenly of any ray: of what is empty or emits light.
CUTS, EVEN_CUTS = 40, 24
# Pixels whose slices are marched at a time, and the least number of steps of a slice.
PIXELS, STEPS = 1024, 4
# Slices of less light, relative to the brightest of the pixel, and of less opacity are dropped.
FAINT = 1e-7


def _ends(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cuts of a ray's opacity, from where it begins to where it ends, as a Quadrature."""
    return np.linspace(0.0, 1.0 - 1e-6, count) if count > 1 else np.zeros(1), np.full(count, 1.0 / count)


@dataclass
class DeepTile:
    """Slices of U pixels of a tile, which passes of colour channels add to.

    pixel: int (U,), ascending, of the tile. knots: (U, n + 1), distances along the pixels' rays. cosine: (U,), between
    them and the viewing axis. added: float32 (U, n, 4), light and opacity.
    """

    pixel: np.ndarray
    knots: np.ndarray
    cosine: np.ndarray
    added: np.ndarray

    def image(self, shape: tuple[int, int], exposure: float) -> DeepImage:
        """The deep image of the tile; shape: its (rows, columns)."""
        counts, first, last, rgba = np.zeros(shape, np.int32), [np.zeros(0)], [np.zeros(0)], [np.zeros((0, 4))]
        for start in range(0, len(self.pixel), 4 * PIXELS):
            some = slice(start, start + 4 * PIXELS)
            knots, added = self.knots[some] * self.cosine[some, None], self.added[some].astype(np.float64)
            begins, joined = thinned(knots, added)
            row, slot = np.nonzero(begins)
            end = slot + joined[row, slot]
            sums = np.concatenate([np.zeros((len(added), 1, 4)), np.cumsum(added, axis=1)], axis=1)
            whole = sums[row, end] - sums[row, slot]
            left = np.maximum(1.0 - sums[row, slot, 3], 1e-12)
            brightest = np.maximum(sums[row, -1, :3].max(axis=1), 1e-30)
            shown = (whole[:, 3] > FAINT) | (whole[:, :3].max(axis=1) > FAINT * brightest)
            row, slot, end = row[shown], slot[shown], end[shown]
            rgba.append(np.clip(whole / left[:, None], 0.0, None)[shown])
            first.append(knots[row, slot])
            last.append(knots[row, end])
            np.add.at(counts.reshape(-1), self.pixel[some][row], 1)
        samples = np.concatenate(rgba)
        samples[:, :3] *= exposure
        samples[:, 3] = np.minimum(samples[:, 3], 1.0)
        front, back = (np.concatenate(ends).astype(np.float32) for ends in (first, last))
        return DeepImage(counts, front, back, samples.astype(np.float32))


class DeepSlicer:
    """Cuts the camera rays of a scene, in a pass of colour channels. Safe on several threads."""

    def __init__(self, context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass):
        self._context, self._scene, self._pass = context, scene, channel_pass
        # All passes cut rays alike.
        grids = zip(scene.grids, (medium for _, medium in scene.plan.volumes))
        self._media = [BoundMedium(grid, medium, float(np.mean(medium.sigma_t)), []) for grid, medium in grids]
        options = MarchOptions(CUTS + 1, optimizations=context.settings.optimizations, quadrature=_ends)
        self._cut = Marcher(self._media, options, [0], context.tasks.stopping)
        self._march = channel_pass.march.without_features()

    def add(self, known: DeepTile | None, tile: Tile, estimates: Sequence[TileEstimate]) -> DeepTile | None:
        """Add the slices of the pass; known: those of other passes in the tile, or None. Raises Cancelled."""
        everything = replace(self._pass, media=self._media, march=self._cut)
        rays = tile_rays(self._context, self._scene, everything, tile.unreported())
        if rays is None:
            return known
        farthest = np.flatnonzero(np.diff(rays.pixel, append=-1))
        if known is None:
            known = self._uncut(rays, farthest)
        first = np.append(0, farthest + 1)
        for start in range(0, len(farthest), PIXELS):
            self._context.cancel.check()
            own = slice(start, min(start + PIXELS, len(farthest)))
            some = slice(first[own.start], first[own.stop])
            known.added[own] += self._slices(known, tile, rays, own, some, estimates)
        return known

    def _uncut(self, rays: TileRays, farthest: np.ndarray) -> DeepTile:
        """Pixels whose rays are to be cut; farthest: number of the ray of each that ends last."""
        batch, knots = rays.batch.take(farthest), []
        for start in range(0, len(farthest), PIXELS):
            self._context.cancel.check()
            some = batch.plain().take(slice(start, start + PIXELS))
            segment = self._cut(some)
            number = np.arange(len(segment.sample_ray)) - np.searchsorted(segment.sample_ray, segment.sample_ray)
            cuts = np.repeat(some.far[:, None], CUTS + 1, axis=1)
            cuts[segment.sample_ray, number] = segment.sample_distance
            even = some.near[:, None] + np.linspace(0.0, 1.0, EVEN_CUTS) * (some.far - some.near)[:, None]
            knots.append(np.sort(np.concatenate([cuts, even], axis=1), axis=1))
        cosine = viewing_cosine(self._scene.camera, batch.directions)
        found = np.concatenate(knots)
        added = np.zeros((len(found), found.shape[1] - 1, 4), np.float32)
        return DeepTile(rays.pixel[farthest], found, cosine, added)

    def _slices(
        self,
        known: DeepTile,
        tile: Tile,
        rays: TileRays,
        own: slice,
        some: slice,
        estimates: Sequence[TileEstimate],
    ) -> np.ndarray:
        """What slices of some of the known pixels add, (u, n, 4); some: their rays."""
        pixel, share = rays.pixel[some], rays.share[some]
        place, batch, knots = np.searchsorted(known.pixel[own], pixel), rays.batch.take(some), known.knots[own]
        begin = np.maximum(knots[place, :-1], batch.near[:, None])
        end = np.minimum(knots[place, 1:], batch.far[:, None])
        ray, slot = np.nonzero(begin < end)
        pieces = RayBatch(batch.origins[ray], batch.directions[ray], begin[ray, slot], end[ray, slot])
        marched = self._marched(pieces)
        thickness = np.concatenate([segment.optical_depth for _, segment in marched])
        opacity = -np.expm1(-thickness.sum(axis=1))
        first = np.searchsorted(ray, np.arange(len(pixel)))
        before = _sums_along(thickness.sum(axis=1), ray, first)
        whole = np.bincount(ray, thickness.sum(axis=1), len(pixel))
        weight = share[ray] * np.exp(-before)
        behind = whole[ray] - before - thickness.sum(axis=1)
        gathered = Framebuffer.black(len(ray))
        shading = Shading(self._scene, self._pass, tile.camera)
        for span, segment in marched:
            numbers = np.arange(len(ray))[span]
            free = rays.free[some][ray[span]] * np.exp(-behind[span])
            single = shading.single(segment, pieces.take(span), pixel[ray[span]], free)
            add_marched(gathered, self._scene, self._pass, MarchedRays(numbers, weight[span], segment, single))
            if segment.lamps is not None:
                add_lamps(gathered, self._scene, self._pass, numbers, weight[span], segment.lamps.single)
        light = (gathered.single + gathered.emission).astype(np.float64)
        held = thickness[:, self._pass.holdouts].sum(axis=1)
        gathered.alpha *= 1.0 - held / np.maximum(thickness.sum(axis=1), 1e-30)
        of_pixel = place[ray]
        for estimate in estimates:
            members = estimate.source.members
            taken = opacity * weight * thickness[:, members].sum(axis=1) / np.maximum(thickness.sum(axis=1), 1e-30)
            told = _told(estimate, known.pixel[own], of_pixel, (ray, first, taken))
            for row, values in zip(estimate.source.rows, told):
                if row.once or self._context.settings.multiple:
                    light[:, row.channels] += values[:, None]
        added = np.zeros((len(known.pixel[own]), knots.shape[1] - 1, 4))
        np.add.at(added, (of_pixel, slot), np.column_stack([light, gathered.alpha]))
        frame = tile.framebuffer
        flat = np.column_stack([frame.single + frame.multiple + frame.emission, frame.alpha])[known.pixel[own]]
        return _scaled(added, flat)

    def _marched(self, pieces: RayBatch) -> list[tuple[slice, RaySegment]]:
        """All pieces of rays, so many at a time as fit in memory. Raises Cancelled."""
        counts, found, start = step_counts(self._march.boxes, pieces, STEPS), [], 0
        sums = np.cumsum(counts)
        while start < len(counts):
            done = sums[start - 1] if start else 0
            end = max(int(np.searchsorted(sums, done + STEPS_PER_TASK)), start + 1)
            self._context.cancel.check()
            span = slice(start, end)
            found.append((span, self._march.march_steps(pieces.take(span), counts[span])))
            start = end
        return found


def _sums_along(values: np.ndarray, ray: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Sums (S,) of values (S,) before each on its ray, int (S,), ascending; first: of each ray, by number."""
    sums = np.cumsum(values) - values
    return sums - sums[np.minimum(first, len(values) - 1)][ray] if len(values) else sums


def _told(
    estimate: TileEstimate,
    pixels: np.ndarray,
    of_pixel: np.ndarray,
    slices: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """Light (K, S) of a source's rows in slices.

    pixels: int (u,), of the tile. of_pixel: int (S,), their numbers. slices: the ray of each and the first of each ray,
    as of `_sums_along`, and the opacity (S,) of the source's volumes.
    """
    ray, first, taken = slices
    rows = len(estimate.source.rows)
    moments = estimate.radiance[:, pixels].reshape(-1, rows, len(pixels))
    total = np.maximum(np.bincount(ray, taken, len(first)), 1e-30)
    before = _sums_along(taken, ray, first)
    ends = (np.clip(2.0 * (before + more) / total[ray] - 1.0, -1.0, 1.0) for more in (0.0, taken))
    low, high = (legendre_integrals(end, len(moments)) for end in ends)
    factors = (high - low) * (np.arange(len(moments)) + 0.5)[:, None]
    found = np.einsum("dkS,dS->kS", moments[:, :, of_pixel], factors) * total[ray]
    np.maximum(found, 0.0, out=found)
    found *= taken > 0.0
    sums = np.stack([np.bincount(of_pixel, row, len(pixels)) for row in found])
    return found * (np.maximum(moments[0], 0.0) / np.maximum(sums, 1e-30))[:, of_pixel]


def _scaled(added: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """What slices add, (u, n, 4), scaled to add what the layer has, (u, 4)."""
    sums = added.sum(axis=1)
    added *= np.where(sums > 0.0, flat / np.where(sums > 0.0, sums, 1.0), 0.0)[:, None]
    # What no slice shows is where the ray is most opaque.
    missed = (sums <= 0.0) & (flat > 0.0)
    u, channel = np.nonzero(missed)
    added[u, added[u, :, 3].argmax(axis=1), channel] = flat[u, channel]
    return added
