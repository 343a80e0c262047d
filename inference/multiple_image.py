"""The image of predicted multiple scattering: what each volume makes of each sun, at the camera rays' depth samples."""

from typing import Tuple

import numpy as np

from .images import add_at
from .multiple import POINTS_A_TASK, MultipleField
from .plan import distinct_albedos
from .shared_pixels import LEVELS, SURPRISE, Squares, agreeing
from .spread_light import turned


def _scatters(plan, channels, g) -> bool:
    """Whether multiple scattering is predicted in a group of volumes, in these channels."""
    return plan.multiple[g] and any(
        channels.sigma_t[v] > 0.0 and distinct_albedos(plan.volumes[v][1], channels.indices, plan.leave_out)
        for v in plan.groups[g])


def _field(plan, channels, network, kept, grids, fields, obstacles, g, work, report) -> Tuple[MultipleField, float]:
    """The field of one group of volumes, made once, and its extinction in these channels."""
    made = g not in fields
    if made:
        work.check()
        fields[g] = kept.field(network, plan.pairs(), g, [grids[v] for v in plan.groups[g]], work.check)
        fields[g].meet(obstacles)
    work.check()
    sigma_t = float(fields[g].medium.sigma_t[channels.indices[0]])
    if made:
        report.warnings += fields[g].warnings(sigma_t)
    return fields[g], sigma_t


def diffuse(plan, channels, network, kept, grids, fields, obstacles, work, report):
    """DiffusedLight of each group of volumes in which multiple scattering is predicted, else None."""
    diffused = []
    for g in range(len(plan.groups)):
        light = None
        if _scatters(plan, channels, g):
            field, sigma_t = _field(plan, channels, network, kept, grids, fields, obstacles, g, work, report)
            light = field.diffused_light(sigma_t, [sun.direction for sun in plan.suns], work.each)
        diffused.append(light)
    return diffused


def add_multiple(
    plan, channels, network, kept, grids, fields, obstacles, samples, camera, settings, work, report, start, end, images,
    whole: bool,
):
    """Add the predicted multiple scattering of every volume and sun to the image, and its uncertainty.

    camera: whose window's pixels `images` are. whole: whether further samples may lie anywhere in the volumes.
    """
    jobs = [(g, l) for g in range(len(plan.groups)) if _scatters(plan, channels, g) for l in range(len(plan.suns))]
    for number, (g, l) in enumerate(jobs):
        sun, group = plan.suns[l], plan.groups[g]
        inside = np.flatnonzero(samples.fraction[:, group].any(axis=1))
        if not len(inside):
            continue
        first, last = (start + (end - start) * n / len(jobs) for n in (number, number + 1))
        message = "multiple scattering of " + " and ".join(plan.volumes[v][0].name for v in group)
        work.progress(first, message)
        with report.stage("fields"):
            field, sigma_t = _field(plan, channels, network, kept, grids, fields, obstacles, g, work, report)
            if "unread_fields" not in settings.leave_out:
                low, high = np.full(3, -0.5), np.full(3, 0.5)
            elif kept.any_view or whole:
                low, high = field.extent()
            else:
                bounds = [field.bounds(samples.positions(points)) for points in _tasks(inside)]
                low, high = np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)
            field.light(sigma_t, sun.direction, low, high, work.each)
            report.count("cells of lookup fields", field.cells())
            work.check()
        report.count("network points wanted", len(inside))
        # Of each volume in the group, (V, 3), scaled by the sun.
        scattered = np.array([plan.volumes[v][1].albedo * sun.irradiance for v in group], np.float32)
        seen = _Seen(samples, group, g, l, field, channels.indices, scattered, len(images.alpha),
                     settings.leave_out)
        if sun.spread is not None:
            seen.directions = turned(camera, samples.pixel, samples.directions, sun, field.medium.anisotropy)
        with report.stage("network"):
            if "shared_pixels" not in settings.leave_out:
                seen.look(inside, work, report, first, last, message)
            else:
                once = images.single[:, channels.indices].T / len(plan.suns)
                _look_and_share(seen, inside, camera.window, once, settings, work, report, first, last, message)
        images.multiple[:, channels.indices] += seen.radiance.T
        images.uncertainty += seen.error


def _tasks(points):
    return [points[i : i + POINTS_A_TASK] for i in range(0, len(points), POINTS_A_TASK)]


class _Seen:
    """What the network has seen of one group of volumes in the light of one sun.

    radiance: (C, P), of the channels rendered together, in double precision, so that it does not show how points were
    divided among calls. error: (P,) its standard error, as a mean over all three channels.
    """

    def __init__(self, samples, group, g, l, field, indices, scattered, pixels, leave_out):
        self.samples, self.g, self.l, self.field, self.indices = samples, g, l, field, indices
        self.albedos = distinct_albedos(field.medium, indices, leave_out)
        self.fraction = samples.fraction[:, group]
        self.scattered = scattered
        self.directions = samples.directions
        self.pixel = samples.pixel[samples.ray]
        self.radiance = np.zeros((len(indices), pixels))
        self.error = np.zeros(pixels, np.float32)

    def look(self, points, work, report, start, end, message):
        """Predict at some samples and add what they show."""
        values = [value for value, _ in self.albedos]
        # What each sample adds to the mean of the three channels.
        parts = np.zeros(len(self.pixel), np.float32)

        def task(points):
            directions = self.directions[self.samples.ray[points]]
            return points, self.field.predict(
                self.samples.positions(points), directions, values, self.samples.jitter(points), self._light(points))

        for seen, radiance in work.map(task, _tasks(points), start, end, message):
            weight = self.samples.weight[seen, None] * (self.fraction[seen] @ self.scattered)
            pixel = self.pixel[seen]
            for (_, members), row in zip(self.albedos, radiance):
                for c in members:
                    part = weight[:, c] * row
                    add_at(self.radiance[self.indices.index(c)], pixel, part)
                    parts[seen] += part / 3.0
        add_at(self.error, *self.samples.standard_error(parts))
        report.count("network points", len(points))
        report.count("network answers", len(points) * len(self.albedos))

    def _light(self, points):
        return self.samples.light.of(points, self.g, self.l) if self.samples.light else None

    def opacity(self):
        """(P,) of the group alone in each pixel, and the mean over it of the light ahead, float32, or None."""
        weight = self.samples.weight * self.fraction.sum(axis=1)
        opacity = np.bincount(self.pixel, weight, len(self.error)).astype(np.float32)
        if not self.samples.light:
            return opacity, None
        ahead = self._light(slice(None))[:, -1]
        return opacity, np.bincount(self.pixel, weight * ahead, len(opacity)) / np.maximum(opacity, np.float32(1e-30))


def _look_and_share(seen, inside, window, once, settings, work, report, start, end, message):
    """Predict where neighbours do not tell, and share where they do.

    window: of the pixels P; once: (C, P), light of the sun scattered once.
    """
    # Means over the volumes' opacity in a pixel are shared; the opacity is known of every pixel.
    opacity, ahead = seen.opacity()
    safe = np.where(opacity > 0.0, opacity, np.float32(1.0))
    # Where the rays of a pixel end at different surfaces, its neighbours do not speak for it.
    alone = np.bincount(seen.samples.pixel, minlength=len(safe)) > 1
    mean, error, off = seen.radiance / safe, seen.error / safe, np.zeros(len(safe), np.float32)
    looked, shares = np.zeros((2, len(safe)), bool)
    pixel, done = seen.pixel[inside], 0

    def look(pixels):
        nonlocal done
        points = inside[pixels[pixel]]
        before, done = done, done + len(points)
        seen.look(points, work, report, *(start + (end - start) * n / len(inside) for n in (before, done)), message)
        looked[pixels] = True
        mean[:, pixels], error[pixels] = seen.radiance[:, pixels] / safe[pixels], seen.error[pixels] / safe[pixels]

    for stride, difference in LEVELS:
        squares = Squares(window, stride).apart_from(shares)
        look(squares.first_look() & ~looked)
        # Errors are those of a mean over all three channels.
        shared, surprise = agreeing(squares, mean.mean(axis=0), error * (3.0 / len(mean)), opacity, once.mean(axis=0), ahead,
                                    difference / np.sqrt(settings.depth_samples))
        shared &= ~squares.any(alone)
        between = squares.between(shared) & ~looked & ~shares
        for values in (*mean, error):
            squares.fill(values, shared, between)
        surprises = np.zeros_like(off)
        surprises[squares.pixels[shared]] = surprise[shared, None]
        off[between] = surprises[between]
        shares |= between
    look(~(looked | shares))
    work.progress(end, message)
    shares &= opacity > 0.0
    seen.radiance[:, shares] = (mean * opacity)[:, shares]
    seen.error[shares] = ((error + SURPRISE * off * (len(mean) / 3.0)) * opacity)[shares]
    report.count("pixels that share their neighbours' multiple scattering", shares.sum())
