"""Adds predicted multiple scattering: what each group of volumes makes of each sun, at the camera rays' depth samples."""


import numpy as np

from ..marching.depth_samples import DepthSamples
from ..marching.extended_lights import turned
from ..network.predictor import POINTS_PER_TASK, PreparedPredictor
from ..plan.plan import distinct_albedos
from ..transport.scattered_fluence import ScatteredFluence
from .adaptive_interpolation import LEVELS, SURPRISE, Squares, agreeing
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at
from .work_estimate import WorkEstimate


def solve_transport(context: RenderContext, scene: PreparedScene, channels) -> list[ScatteredFluence | None] | None:
    """Scattered fluence of each group in which multiple scattering is predicted, for networks that need ray features."""
    network, plan = scene.network, scene.plan
    if network is None or not network.needs_ray_features:
        return None
    directions, found = [sun.direction for sun in plan.suns], []
    with context.report.stage("fields"):
        for g, group in enumerate(scene.groups):
            fluence = None
            if plan.predicts(g, channels):
                sigma_t = float(group.medium.sigma_t[channels.indices[0]])
                with context.progress.stage("transport", len(directions)):
                    fluence = group.predictor.fluence(sigma_t, directions, scene.occluders, context.tasks)
            found.append(fluence)
    return found


def add_multiple_scattering(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, tile: Tile, samples: DepthSamples,
    work: WorkEstimate,
) -> None:
    """Add the predicted multiple scattering of every group and sun to the tile, and its uncertainty. Raises Cancelled."""
    if scene.network is None:
        return
    plan = scene.plan
    for g in range(len(plan.groups)):
        if plan.predicts(g, channel_pass.channels):
            for l in range(len(plan.suns)):
                _add_one(context, scene, channel_pass, tile, samples, (g, l))
                work.job_predicted(tile)


def _add_one(context, scene, channel_pass, tile, samples, group_and_sun):
    """Add what one group makes of one sun."""
    g, l = group_and_sun
    plan, report, indices = scene.plan, context.report, channel_pass.channels.indices
    sun, members, group = plan.suns[l], plan.groups[g], scene.groups[g]
    inside = np.flatnonzero(samples.fraction[:, members].any(axis=1))
    if not len(inside):
        return
    context.progress.message(f"multiple scattering of {plan.group_name(g)}")
    with report.stage("fields"):
        bounds = _bounds(context, scene, group.predictor, samples, inside)
        with context.progress.stage("lattices", 1):
            prepared = group.predictor.prepare(
                float(group.medium.sigma_t[indices[0]]), sun.direction, bounds, scene.occluders, context.tasks)
        report.count("cells of lookup fields", prepared.lattice_cells)
        context.cancel.check()
    report.count("network points wanted", len(inside))
    estimate = _Estimate(context, samples, len(tile.framebuffer.alpha), prepared, _Source(plan, g, l, indices, group.medium))
    if sun.spread is not None:
        estimate.directions = turned(tile.camera, samples.pixel, samples.directions, sun, group.medium.anisotropy)
    with report.stage("network"), context.progress.stage("network"):
        if "shared_pixels" not in context.settings.leave_out:
            estimate.evaluate(inside)
        else:
            single = tile.framebuffer.single[:, indices].T / len(plan.suns)
            _evaluate_adaptively(estimate, inside, tile.camera.window, single)
    tile.framebuffer.multiple[:, indices] += estimate.radiance.T
    tile.framebuffer.uncertainty += estimate.error


def _bounds(context, scene, predictor, samples, inside):
    """Lowest and highest (3,), in the cube's frame, of the points for which lookup lattices are built."""
    if "unread_fields" not in context.settings.leave_out:
        return np.full(3, -0.5), np.full(3, 0.5)
    if context.cache.any_view or len(scene.plan.tiles) > 1:
        return predictor.extent()
    bounds = [predictor.bounds(samples.positions(points)) for points in _batches(inside)]
    return np.min([low for low, _ in bounds], axis=0), np.max([high for _, high in bounds], axis=0)


def _batches(points):
    return [points[i : i + POINTS_PER_TASK] for i in range(0, len(points), POINTS_PER_TASK)]


class _Source:
    """One group in the light of one sun: what it scatters.

    albedos: distinct albedos of the channels rendered together, and the channels of each. scattered: float32 (V, 3) albedo
    times irradiance of each of the group's volumes.
    """

    def __init__(self, plan, g: int, l: int, indices: list[int], medium):
        self.group, self.sun, self.members, self.indices = g, l, plan.groups[g], indices
        self.albedos = distinct_albedos(medium, indices, plan.leave_out)
        irradiance = plan.suns[l].irradiance
        self.scattered = np.array([plan.volumes[v][1].albedo * irradiance for v in self.members], np.float32)


class _Estimate:
    """The network's estimate of one group's multiple scattering of one sun, in P pixels.

    radiance: (C, P), of the channels rendered together, in double precision, so that it does not show how points were
    divided among calls. error: float32 (P,) its standard error, as a mean over all three channels.
    """

    def __init__(self, context: RenderContext, samples: DepthSamples, pixels: int, prepared: PreparedPredictor,
                 source: _Source):
        self.context, self.samples, self.prepared, self.source = context, samples, prepared, source
        self.fraction = samples.fraction[:, source.members]
        self.directions = samples.directions
        self.pixel = samples.pixel[samples.ray]
        self.radiance = np.zeros((len(source.indices), pixels))
        self.error = np.zeros(pixels, np.float32)

    def evaluate(self, points) -> None:
        """Predict at some samples and add their radiance."""
        context, samples, source = self.context, self.samples, self.source
        values = [value for value, _ in source.albedos]
        # What each sample adds to the mean of the three channels.
        parts = np.zeros(len(self.pixel), np.float32)

        def task(points):
            directions = self.directions[samples.ray[points]]
            return points, self.prepared.predict(
                samples.positions(points), directions, values, samples.jitter(points), self._features(points))

        for done, radiance in context.tasks.map(task, _batches(points)):
            weight = samples.weight[done, None] * (self.fraction[done] @ source.scattered)
            pixel = self.pixel[done]
            for (_, channels), row in zip(source.albedos, radiance):
                for c in channels:
                    part = weight[:, c] * row
                    add_at(self.radiance[source.indices.index(c)], pixel, part)
                    parts[done] += part / 3.0
            context.progress.advance("network", len(done))
        add_at(self.error, *samples.standard_error(parts))
        context.report.count("network points", len(points))
        context.report.count("network answers", len(points) * len(source.albedos))

    def _features(self, points):
        features = self.samples.features
        return None if features is None else features.of(points, self.source.group, self.source.sun)

    def opacity(self):
        """(P,) of the group alone in each pixel, and the mean over it of the light ahead, float32, or None."""
        weight = self.samples.weight * self.fraction.sum(axis=1)
        opacity = np.bincount(self.pixel, weight, len(self.error)).astype(np.float32)
        features = self._features(slice(None))
        if features is None:
            return opacity, None
        ahead = np.bincount(self.pixel, weight * features[:, -1], len(opacity))
        return opacity, ahead / np.maximum(opacity, np.float32(1e-30))


def _evaluate_adaptively(estimate: _Estimate, inside, window, single) -> None:
    """Predict where neighbours do not agree, and interpolate where they do.

    window: of the P pixels; single: (C, P) single scattering of the sun.
    """
    # Means over the volumes' opacity in a pixel are interpolated; the opacity is known of every pixel.
    opacity, ahead = estimate.opacity()
    safe = np.where(opacity > 0.0, opacity, np.float32(1.0))
    # Where the rays of a pixel end at different surfaces, its neighbours do not stand for it.
    alone = np.bincount(estimate.samples.pixel, minlength=len(safe)) > 1
    mean, error, off = estimate.radiance / safe, estimate.error / safe, np.zeros(len(safe), np.float32)
    evaluated, interpolated = np.zeros((2, len(safe)), bool)
    pixel, report = estimate.pixel[inside], estimate.context.report

    def evaluate(pixels):
        estimate.evaluate(inside[pixels[pixel]])
        evaluated[pixels] = True
        mean[:, pixels] = estimate.radiance[:, pixels] / safe[pixels]
        error[pixels] = estimate.error[pixels] / safe[pixels]

    for stride, difference in LEVELS:
        squares = Squares(window, stride).apart_from(interpolated)
        evaluate(squares.first_look() & ~evaluated)
        # Errors are those of a mean over all three channels.
        shared, surprise = agreeing(
            squares, mean.mean(axis=0), error * (3.0 / len(mean)), opacity, single.mean(axis=0), ahead,
            difference / np.sqrt(estimate.context.settings.depth_samples))
        shared &= ~squares.any(alone)
        between = squares.between(shared) & ~evaluated & ~interpolated
        for values in (*mean, error):
            squares.fill(values, shared, between)
        surprises = np.zeros_like(off)
        surprises[squares.pixels[shared]] = surprise[shared, None]
        off[between] = surprises[between]
        interpolated |= between
    evaluate(~(evaluated | interpolated))
    interpolated &= opacity > 0.0
    estimate.radiance[:, interpolated] = (mean * opacity)[:, interpolated]
    surprise = SURPRISE * off * (len(mean) / 3.0)
    estimate.error[interpolated] = ((error + surprise) * opacity)[interpolated]
    report.count("pixels that share their neighbours' multiple scattering", interpolated.sum())
