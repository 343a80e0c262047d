# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene in, baked light out: multiple scattering as emission of the volumes, for renderers of single scattering."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..image.context import PreparedScene, RenderContext
from ..kernels.library import load_kernels
from ..plan.detail import without_detail
from ..plan.plan import Channels, last_albedo
from ..plan.precision import in_range
from ..points.group_radiance import STEPS_PER_POINT, GroupRadiance
from ..render import prepare_scene
from ..render_cache import RenderCache
from ..runtime.cancellation import CancelToken
from ..runtime.progress import Progress
from ..runtime.report import Report, process_peak_memory
from ..runtime.tasks import Tasks
from ..scene.camera import Camera
from ..scene.description import Medium, Surface, Volume
from ..scene.light import Light
from ..scene.settings import Settings
from .directional_factor import ANCHORS, DETAIL_SHARPNESS, BakedView, NodeGrid
from .directions import (
    FINE_NODES,
    IMPORTANT_SHARE,
    MAX_POINTS,
    DirectionFit,
    expected_work,
    make_lobe,
    sampled_directions,
    stride_of,
)
from .guided_light import GuidedLight, KnownLight, LightPart, PointGrid, grey_of
from .lattice import DIRECTIONS, WEIGHTS, BakeLattice, Visibility, block_means, make_lattice
from .lit_volume import LitVolume
from .smooth_light import (
    FEW,
    SKY_STRIDES,
    STRIDES,
    continued,
    expected_predictions,
    importance_of,
    radiance_in_voxels,
)

# Least transmittance with which a direction counts in the mean over those that show a voxel.
HARDLY_SEEN = 1e-3
# Voxels of density, along an edge, in one in which light is baked, at most, where `most_voxels` joins voxels.
FINER = 3
# For plans of images, of which a bake makes none.
_NO_IMAGE = Camera(np.eye(4), resolution=(1, 1))
# Points that are evaluated together: ray features of all suns are held at once.
POINTS_PER_BATCH = 1 << 16
# Predictions for each of the directions whose mean is baked.
MEAN_PREDICTIONS = 6000
# Predictions of the light of environments, which is smooth, over those of lights.
SKY_SHARE = 0.5
# Where lamps and environments light a volume, the one that gives less than half of the light has fewer predictions for
# other directions, but at least this share of them.
LEAST_SHARE = 0.1


def bake(
    volumes: Sequence[tuple[Volume, Medium]],
    lights: Sequence[Light],
    camera: Camera | None = None,
    settings: Settings | None = None,
    progress: Callable[[float, str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    cache: RenderCache | None = None,
    surfaces: Sequence[Surface] = (),
) -> list[LitVolume]:
    """Bake the light that volumes scatter more than once into emission, one LitVolume per volume.

    A renderer that shows the volumes with single scattering and adds this emission, attenuated by them, shows what
    `render` does, in the light of suns, lamps and environments alike. Overlapping volumes share the light; each has the
    emission of its own scattering.

    volumes, lights, progress, cancelled, cache, surfaces: as for `render`; surfaces keep light from the volumes, absorb
    what these scatter and throw light back, but hide no voxel. What volumes scatter of the light that surfaces throw
    back is baked as a whole, single scattering included. camera: from which light is baked exactly; other directions
    are right through `LitVolume.directional`. Only its place and the size of its pixels matter. Without a camera the
    mean over the directions that show a voxel is baked. settings: of these `model`, `threads`, `memory_limit`,
    `multiple`, `provider`, `directional`, `most_voxels` and `optimizations`.

    Raises SceneError for a scene that cannot be rendered, Cancelled when asked to stop.
    """
    settings, report = without_detail(settings or Settings()), Report()
    scaled = [in_range(volume, medium) for volume, medium in volumes]
    with Tasks(settings.threads, CancelToken(cancelled)) as tasks:
        with report.stage("total"):
            # Without a camera, no surface is known to hide a part of the volumes from it.
            seen = [replace(surface, covers=surface.covers and camera is not None) for surface in surfaces]
            place = (
                _NO_IMAGE
                if camera is None
                else replace(camera, resolution=(1, 1), region=None, lens=None, shutter=None)
            )
            if cache is None or "unchanged" not in settings.optimizations:
                cache = RenderCache()
            report.kernels = load_kernels().name
            context = RenderContext(settings, cache, tasks, Progress(progress), report)
            scene = prepare_scene(context, scaled, lights, place, seen)
            lit = _Bake(context, scene, camera).run() if scene.plan.volumes else {}
    context.progress.finish()
    report.planned, report.left_out = scene.plan.planned, scene.plan.left_out
    report.threads, report.peak_memory = tasks.threads, process_peak_memory()
    report.warnings = list(dict.fromkeys(report.warnings))
    baked, found = 0, []
    for (volume, _), (original, _) in zip(scaled, volumes):
        # The plan leaves out volumes without light of their own.
        if baked < len(scene.plan.volumes) and scene.plan.volumes[baked][0] is volume:
            found.append(lit[baked])
            baked += 1
        else:
            empty, dark = np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1, 3), np.float32)
            found.append(LitVolume(empty, dark, original.world_from_index, name=original.name, report=report))
    return found


def baked_view(camera: Camera | None) -> BakedView:
    """The rays along which light is baked for a camera, or for none."""
    if camera is None:
        return BakedView()
    up, axis = (camera.world_matrix[:3, column] for column in (1, 2))
    up = up / np.linalg.norm(up)
    if camera.projection == "orthographic":
        return BakedView(direction=-axis / np.linalg.norm(axis), up=up)
    return BakedView(position=camera.world_matrix[:3, 3].copy(), up=up)


class _Bake:
    """One bake of a prepared scene."""

    def __init__(self, context: RenderContext, scene: PreparedScene, camera: Camera | None):
        self.context, self.scene, self.camera = context, scene, camera
        self.view, self._switches = baked_view(camera), context.settings.optimizations
        self.lattices = [self._lattice(v) for v in range(len(scene.plan.volumes))]
        self.visibilities = [self._visibility(v) for v in range(len(scene.plan.volumes))]
        # Along the directions whose mean is baked, of each volume.
        self._known: list[list[KnownLight]] = [[] for _ in self.lattices]
        # What lamps and environments give to each volume, where they were predicted apart.
        self._given = np.zeros((len(self.lattices), 2))
        self._expect()

    def run(self) -> dict[int, LitVolume]:
        """The LitVolume of each of the plan's volumes, by number."""
        shapes = [lattice.density.shape for lattice in self.lattices]
        radiance = [np.zeros((*shape, 3), np.float32) for shape in shapes]
        predicted: list[tuple[int, GroupRadiance]] = []
        for channels in self.scene.plan.channels:
            for g, _ in self.scene.predicted(channels):
                light = GroupRadiance(self.context, self.scene, g, channels)
                predicted.append((g, light))
                for v in self.scene.plan.groups[g]:
                    radiance[v] += self._radiance(v, channels, light)
        steady = [np.zeros_like(values) for values in radiance]
        for g, scatters in enumerate(self.scene.plan.scattered_emission):
            for v in self.scene.plan.groups[g] if scatters else ():
                steady[v] = self._scattered_emission(g, v)
        groups = self.scene.plan.groups
        return {
            v: self._lit(v, radiance[v], steady[v], [light for g, light in predicted if v in groups[g]])
            for v in range(len(radiance))
        }

    def _lattice(self, v: int) -> BakeLattice:
        self.context.cancel.check()
        return make_lattice(self.scene.plan.volumes[v][0], self.scene.grids[v], self.camera, self.context.settings)

    def _visibility(self, v: int) -> Visibility:
        sigma_t = self.scene.plan.volumes[v][1].sigma_t
        thinnest = float(sigma_t[sigma_t > 0.0].min()) if np.any(sigma_t > 0.0) else 0.0
        with self.context.report.stage("visibility"):
            return Visibility(self.lattices[v], thinnest, self.context.cancel)

    def _expect(self) -> None:
        """Tell the progress what there is to do."""
        progress, plan = self.context.progress, self.scene.plan
        lights = len(plan.predicted_suns()) + plan.predicts_lamps * len(plan.lamps) + bool(self.scene.environments)
        jobs = lights * len(plan.channels)
        points = sum(map(self._expected_points, range(len(self.lattices))))
        progress.expect("transport", jobs * len(plan.groups))
        progress.expect("lattices", jobs * len(plan.groups))
        progress.expect("march", STEPS_PER_POINT * points * len(plan.channels))
        progress.expect("network", points * jobs)

    def _expected_points(self, v: int) -> float:
        """Predictions of each light in one volume, about."""
        lattice, visibility = self.lattices[v], self.visibilities[v]
        voxels, longest = float(np.count_nonzero(self._wanted(v))), max(lattice.density.shape)
        thickness, smooth = visibility.most_extinction * lattice.voxel, "smooth_light" in self._switches
        if self._sees_all_around and smooth and voxels > FEW:
            points = IMPORTANT_SHARE * voxels / stride_of(longest, FINE_NODES, thickness) ** 3
            return len(DIRECTIONS) * min(points, MEAN_PREDICTIONS) + self._expected_directions(v)
        times = len(DIRECTIONS) if self._sees_all_around else 1
        return times * expected_predictions(voxels, STRIDES if smooth else (1,)) + self._expected_directions(v)

    def _expected_directions(self, v: int) -> float:
        """The same for other directions alone."""
        if not self.context.settings.directional:
            return 0.0
        lattice = self.lattices[v]
        anisotropy = self.scene.plan.volumes[v][1].anisotropy
        directions = sampled_directions(make_lobe([one.sun for one in self.scene.plan.predicted_suns()], anisotropy))
        return expected_work(
            float(np.count_nonzero(self._wanted(v))),
            max(lattice.density.shape),
            self.visibilities[v].most_extinction * lattice.voxel,
            len(directions),
            0 if self._sees_all_around else len(ANCHORS) - 1,
        )

    def _wanted(self, v: int) -> np.ndarray:
        """bool (nx, ny, nz): voxels whose light is baked."""
        wanted = self.lattices[v].density > 0.0
        if "unseen_voxels" in self._switches:
            wanted &= self.visibilities[v].seen()
        return wanted

    def _radiance(self, v: int, channels: Channels, light: GroupRadiance) -> np.ndarray:
        """Multiple scattering (nx, ny, nz, 3) of one volume in some colour channels, for an albedo of 1."""
        lattice, report = self.lattices[v], self.context.report
        self.context.progress.message(f"multiple scattering in {self.scene.plan.volumes[v][0].name}")
        wanted = self._wanted(v)
        report.count("voxels with light", np.count_nonzero(wanted))
        smooth = "smooth_light" in self._switches and np.count_nonzero(wanted) > FEW
        if smooth and self._sees_all_around:
            return self._mean_radiance(v, light, wanted)
        thickness = lattice.density * np.float32(lattice.voxel * channels.sigma_t[v])
        importance = importance_of(thickness, self.visibilities[v].towards(self.view, lattice))
        radiance = np.zeros((*wanted.shape, 3), np.float32)
        # Light that surfaces throw back changes fast beside them.
        apart = smooth and self.scene.thrown_back is None
        for kind, (part, strides) in enumerate(zip(light.parts if apart else (light, None), (STRIDES, SKY_STRIDES))):
            if part is not None:
                strides = strides if "smooth_light" in self._switches else (1,)
                expected = expected_predictions(np.count_nonzero(wanted), strides)

                def predict(voxels: np.ndarray, part: GroupRadiance = part) -> np.ndarray:
                    nonlocal expected
                    # Whatever is left of what is expected is taken back at the end.
                    self._expect_more(part, max(len(voxels) - expected, 0.0))
                    expected = max(expected - len(voxels), 0.0)
                    return self._predicted(part, lattice.positions(voxels))

                # Errors of the World's light count less beside that of lamps.
                beside = radiance if radiance.any() else None
                found, predicted = radiance_in_voxels(wanted, importance, predict, strides, beside)
                self._expect_more(part, -expected)
                radiance += found
                self._given[v, kind] += float(found.sum()) if apart else 0.0
                report.count("voxels predicted", predicted)
        return radiance

    def _expect_more(self, light: GroupRadiance, points: float) -> None:
        for stage, amount in light.work.items():
            self.context.progress.expect_more(stage, amount * points)

    def _in_voxels(self, v: int, values: np.ndarray, grid: PointGrid, wanted: np.ndarray) -> np.ndarray:
        """Light (nx, ny, nz, 3) in the wanted voxels, from that on a coarse grid."""
        radiance = np.zeros((*wanted.shape, 3), np.float32)
        nodes = NodeGrid(values, grid.world_from_index)
        radiance[wanted] = nodes.sample(self.lattices[v].positions(np.argwhere(wanted)))
        return radiance

    @property
    def _sees_all_around(self) -> bool:
        return self.view.directions(np.zeros((1, 3))) is None

    def _mean_radiance(self, v: int, light: GroupRadiance, wanted: np.ndarray) -> np.ndarray:
        """As `_radiance`, of the mean over the directions that show a voxel."""
        lattice, visibility = self.lattices[v], self.visibilities[v]
        guided = self._guided(v, [light], lambda positions: np.ones((1, 3), np.float32))
        stride = stride_of(max(lattice.density.shape), FINE_NODES, visibility.most_extinction * lattice.voxel)
        while np.count_nonzero(filled := block_means(wanted.astype(np.float32), stride)) * len(DIRECTIONS) > MAX_POINTS:
            stride += 1
        places = np.argwhere(filled)
        along = guided.at(stride, places)
        grid = along.grid
        voxels = lattice.voxels(grid.positions(places))
        # A ray along a direction shows a point to a viewer on the other side of it.
        shares = WEIGHTS * np.maximum(visibility.transmittances(voxels, -DIRECTIONS), HARDLY_SEEN)
        shares /= shares.sum(axis=1, keepdims=True)
        mean = np.zeros((len(places), 3), np.float32)
        for direction, share in zip(DIRECTIONS, shares.T.astype(np.float32)):
            mean += share[:, None] * along(BakedView(direction=direction), share, MEAN_PREDICTIONS)
        self._known[v] += guided.known
        return self._in_voxels(v, grid.spread(places, mean), grid, wanted)

    def _predicted(self, light: GroupRadiance, positions: np.ndarray) -> np.ndarray:
        """Radiance (3, N) at world positions (N, 3), along the baked view, or its mean over all directions."""
        parts = []
        for start in range(0, len(positions), POINTS_PER_BATCH):
            self.context.cancel.check()
            some = positions[start : start + POINTS_PER_BATCH]
            along = self.view.directions(some)
            if along is not None:
                parts.append(light(some, along))
                continue
            mean = np.zeros((3, len(some)), np.float32)
            for direction, weight in zip(DIRECTIONS, WEIGHTS):
                mean += np.float32(weight) * light(some, np.broadcast_to(direction, some.shape).copy())
            parts.append(mean)
        return np.concatenate(parts, axis=1)

    def _scattered_emission(self, g: int, v: int) -> np.ndarray:
        """What one volume scatters of the emission of its group, (nx, ny, nz, 3), for an albedo of 1."""
        scene, context = self.scene, self.context
        members = scene.plan.members(g)
        with context.report.stage("emission"):
            grids = [scene.grids[n] for n in scene.plan.groups[g]]
            emission = context.cache.scattered_emission(members, grids, g, context.cancel)
        warnings = emission.warnings(scene.plan.group_name(g))
        context.report.warnings += [warning for warning in warnings if warning not in context.report.warnings]
        wanted, lattice = self._wanted(v), self.lattices[v]
        positions = lattice.positions(np.argwhere(wanted))
        along, medium = self.view.directions(positions), scene.plan.volumes[v][1]
        # The mean over all directions has no flux.
        anisotropy = medium.anisotropy if along is not None else 0.0
        radiance = np.zeros((*wanted.shape, 3), np.float32)
        directions = np.zeros_like(positions) if along is None else along
        radiance[wanted] = emission.scattered(range(3), positions, directions, anisotropy).T
        return radiance

    def _coefficient(self, v: int, positions: np.ndarray | None) -> np.ndarray:
        """Scattering per unit density and world unit, float32 (3,), or where the albedo varies (N, 3) at positions
        (N, 3) in the world; (nx, ny, nz, 3) in the lattice's voxels for None.
        """
        volume, medium = self.scene.plan.volumes[v]
        coefficient = (medium.sigma_t * last_albedo(volume, medium)).astype(np.float32)
        if volume.scattering is None:
            return coefficient
        grid, lattice = self.scene.grids[v], self.lattices[v]
        shape = lattice.density.shape if positions is None else positions.shape[:1]
        if positions is None:
            positions = lattice.positions(np.argwhere(np.ones(shape, bool)))
        index = grid.index(positions).T.astype(np.float32)
        density = np.maximum(grid.sample_density(index), np.float32(1e-30))
        albedo = np.stack([np.minimum(grid.scattering_of(c).sample(index) / density, 1.0) for c in range(3)], axis=1)
        return coefficient * albedo.reshape(*shape, 3)

    def _guided(
        self, v: int, lights: Sequence[GroupRadiance], coefficient: Callable[[np.ndarray], np.ndarray]
    ) -> GuidedLight:
        """Light of one volume from some lights; coefficient: of its scattering at positions (N, 3)."""
        lattice, visibility = self.lattices[v], self.visibilities[v]

        def part(kind: int, share: float) -> list[LightPart]:
            alike = [one for one in (light.parts[kind] for light in lights) if one is not None]
            if total := self._given[v].sum():
                share *= float(np.clip(2.0 * self._given[v, kind] / total, LEAST_SHARE, 1.0))
            for one in alike:
                self._expect_more(one, (share - 1.0) * self._expected_directions(v))

            def predict(positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
                radiance = np.sum([one(positions, directions) for one in alike], axis=0)
                scattered: np.ndarray = coefficient(positions) * radiance.T
                return scattered

            def unscattered(positions: np.ndarray) -> np.ndarray:
                if kind:
                    return visibility.openness(lattice.voxels(positions))
                return np.sum([one.unscattered(positions) for one in alike], axis=0)

            return [LightPart(predict, unscattered, share)] if alike else []

        every = "smooth_light" not in self._switches or np.count_nonzero(self._wanted(v)) <= FEW
        extinction = lattice.density * np.float32(self.scene.plan.volumes[v][1].sigma_t.mean())
        return GuidedLight(lattice, extinction, [*part(0, 1.0), *part(1, SKY_SHARE)], every)

    def _lit(self, v: int, radiance: np.ndarray, steady: np.ndarray, lights: list[GroupRadiance]) -> LitVolume:
        """Baked light from what suns, (nx, ny, nz, 3), and volumes, the same, light up."""
        volume, medium = self.scene.plan.volumes[v]
        lattice, report = self.lattices[v], self.context.report
        coefficient = self._coefficient(v, None)
        steady, scattered = coefficient * steady, coefficient * (radiance + steady)
        directional = None
        if self.context.settings.directional and lights:
            self.context.progress.message(f"other directions of {volume.name}")
            lobe = make_lobe([one.sun for one in self.scene.plan.predicted_suns()], medium.anisotropy)
            guided = self._guided(v, lights, lambda positions: self._coefficient(v, positions))
            known = self.view.directions(guided.middle[None])
            if known is not None:
                guided.known.append(KnownLight(known[0], PointGrid.over(lattice, 1), grey_of(scattered)))
            guided.known.extend(self._known[v])
            with report.stage("directions"):
                fit = DirectionFit(lattice, scattered, steady, self.visibilities[v], lobe, self.view, guided)
                directional = fit.factor(DETAIL_SHARPNESS * medium.anisotropy**2)
        scattered = continued(scattered, self._wanted(v))
        frame, fine = lattice.world_from_index, self._fine(v)
        return LitVolume(lattice.density, scattered, frame, directional, fine, volume.name, report)

    def _fine(self, v: int) -> BakeLattice | None:
        """The density of one volume in smaller voxels, where light is baked in few: it varies more than light does."""
        settings = self.context.settings
        if not settings.most_voxels:
            return None
        smaller = replace(settings, most_voxels=FINER * settings.most_voxels)
        fine = make_lattice(self.scene.plan.volumes[v][0], self.scene.grids[v], self.camera, smaller)
        return fine if fine.coarsening < self.lattices[v].coarsening else None
