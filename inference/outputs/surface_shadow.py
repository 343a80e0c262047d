# SPDX-License-Identifier: GPL-3.0-or-later
"""The shadow of volumes on the surfaces that a camera sees: what they let through of the light of suns and lamps."""

from dataclasses import replace

import numpy as np

from ..image.context import PreparedScene, RenderContext
from ..image.framebuffer import Window
from ..image.reflected_light import lamp_light, passed_sun, shading_surfaces, sun_light, sun_visibility
from ..occluders.depth_buffer import SAMPLES
from ..occluders.seen_surfaces import SeenPoints
from ..plan.lights import linking
from ..scene.camera_rays import image_rays
from ..scene.description import Surface

# Pixels whose shadow is computed at a time, and the sample points of each, of SAMPLES x SAMPLES, by column and row.
PIXELS, POINTS = 1 << 16, ((0, 1), (2, 0), (1, 3), (3, 2))


def surface_shadow(context: RenderContext, scene: PreparedScene, surfaces: list[Surface]) -> np.ndarray:
    """float32 (H, W, 3): light of suns and lamps that volumes let through to the surface of each pixel, over the light
    that would arrive without them; 1 without a surface, and where none arrives.

    Light that volumes scatter forwards counts as let through. surfaces: all of the scene. Raises Cancelled.
    """
    x0, y0, x1, y1 = scene.camera.window
    shadow = np.ones((y1 - y0, x1 - x0, 3), np.float32)
    covering = [(number, surface) for number, surface in enumerate(surfaces) if surface.covers]
    if scene.depth_buffer is None or not scene.grids:
        return shadow
    triangles = np.concatenate([surface.triangles for _, surface in covering])
    owner = np.repeat([number for number, _ in covering], [len(surface.triangles) for _, surface in covering])
    height = max(PIXELS // (x1 - x0), 1)
    bands = [(x0, top, x1, min(top + height, y1)) for top in range(y0, y1, height)]

    for band in bands:
        pixel, seen = _seen(scene, band, (triangles, owner), context)
        if not len(pixel):
            continue
        light = _light(context, scene, surfaces, seen)
        count = (band[3] - band[1]) * (band[2] - band[0])
        sums = np.stack([[np.bincount(pixel, part[:, c], count) for c in range(3)] for part in light])
        lit = sums[1] > 0.0
        found = np.where(lit, sums[0] / np.where(lit, sums[1], 1.0), 1.0)
        shadow[band[1] - y0 : band[3] - y0] = found.T.reshape(band[3] - band[1], -1, 3)
    return shadow


def _seen(
    scene: PreparedScene, band: Window, surfaces: tuple[np.ndarray, np.ndarray], context: RenderContext
) -> tuple[np.ndarray, SeenPoints]:
    """Pixels, int (N,), and the points of surfaces in them; surfaces: triangles (T, 3, 3), and the owner of each."""
    assert scene.depth_buffer is not None
    (triangles, owner), (x0, y0, x1, y1) = surfaces, band
    numbers = scene.depth_buffer.triangles(band, context.cancel)
    rows, columns = np.mgrid[0 : y1 - y0, 0 : x1 - x0].reshape(2, -1)
    pixel = np.tile(np.arange(len(rows)), len(POINTS))
    across, down = (
        np.concatenate([at * SAMPLES + point[axis] for point in POINTS]) for axis, at in enumerate((columns, rows))
    )
    number = numbers[down, across]
    hit = np.flatnonzero(number >= 0)
    x, y = (first + (at[hit] + 0.5) / SAMPLES for first, at in ((x0, across), (y0, down)))
    origins, directions, _ = image_rays(scene.camera, x, y)
    corner, second, third = np.moveaxis(triangles[number[hit]], 1, 0)
    normals = np.cross(second - corner, third - corner)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    towards = (normals * directions).sum(axis=1)
    normals[towards > 0.0] *= -1.0
    # Triangles seen from beside have no point in the middle of a sample.
    distance = ((corner - origins) * normals).sum(axis=1) / np.minimum(-np.abs(towards), -1e-9)
    seen = SeenPoints(points=origins + distance[:, None] * directions, normals=normals, owner=owner[number[hit]])
    return pixel[hit], seen


def _light(
    context: RenderContext, scene: PreparedScene, surfaces: list[Surface], seen: SeenPoints
) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance (N, 3) of points by suns and lamps behind volumes and surfaces, and without volumes."""
    plan, cancel = scene.plan, context.cancel
    dimmed, whole = np.zeros((2, len(seen.points), 3))
    names, shading = [surface.name for surface in surfaces], shading_surfaces(surfaces, seen, scene.corners)
    sunlit, lamplit = (linking(lights, names)[seen.owner] for lights in (plan.suns, plan.lamps))
    outside = np.zeros(len(seen.points), bool)
    light_of_suns = [
        sun_light(sun, seen) * sunlit[:, number] * sun_visibility(shading, sun, seen, scene.corners, cancel)
        for number, sun in enumerate(plan.suns)
    ]
    for channels in plan.channels:
        c, media = channels.indices, scene.media(channels)
        clear = [replace(bound, sigma_t=0.0) for bound in media]
        for number, (sun, light) in enumerate(zip(plan.suns, light_of_suns)):
            cancel.check()
            arriving = light[:, None] * sun.irradiance[c]
            whole[:, c] += arriving
            dimmed[:, c] += arriving * passed_sun(media, number, seen.points, c, outside)
        for number, lamp in enumerate(scene.lamps):
            cancel.check()
            power = lamp.lamp.power[c] * lamplit[:, number, None]
            whole[:, c] += lamp_light(lamp, clear, seen, c) * power
            dimmed[:, c] += lamp_light(lamp, media, seen, c) * power
    return dimmed, whole
