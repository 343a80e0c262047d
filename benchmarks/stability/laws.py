# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds in every scene: renders with the shipped network, against each other and against the path tracer."""

import functools
from dataclasses import replace

import numpy as np

from evaluation.error import relative_bias, relative_rmse
from inference import Medium, Settings, Sun, predict_multiple, render
from inference.network.network import register_system
from inference.network.predictor import MAX_FLUENCE
from inference.scene.phase_function import henyey_greenstein

from .case import Case, Outcome, unsound
from .placements import CLOUD, scaled, shifted
from .scenes import SUN, camera, moved, rotation

VIEW = camera(pixels=12)
MEDIUM = Medium(30.0, 0.95, 0.5)


def draw(volume=CLOUD, medium=MEDIUM, suns=(SUN,), view=VIEW, settings=Settings(4)):
    return render([(volume, medium)], list(suns), view, settings)


@functools.lru_cache
def plain():
    return draw()


def same(other, factor=1.0):
    """Largest difference to the plain render, relative to its mean."""
    difference = np.abs(other.rgb.astype(np.float64) / factor - plain().rgb).max() / plain().rgb.mean()
    return Outcome({"unsound": unsound(other), "largest": float(difference)}, other.rgb / other.rgb.max())


def turned():
    turn = rotation(1.1)
    view = camera(pixels=12)
    view.world_matrix[:3] = turn @ view.world_matrix[:3]
    return same(draw(moved(CLOUD, turn), suns=(Sun(turn @ SUN.direction),), view=view))


def resized(k: float):
    volume, _, _ = scaled(k)
    view = camera(k * VIEW.world_matrix[:3, 3], pixels=12)
    return same(draw(volume, Medium(30.0 / k, 0.95, 0.5), view=view))


def far_away():
    volume, _, view = shifted(1e7)
    view.resolution = (12, 12)
    return same(draw(volume, view=view))


def at_one_place(count: int):
    """So many instances of the cloud inside each other, which share its extinction."""
    medium = Medium(30.0 / count, 0.95, 0.5)
    volumes = [(CLOUD.instance(CLOUD.world_from_index, f"cloud {n}"), medium) for n in range(count)]
    return same(render(volumes, [SUN], VIEW, Settings(4)))


def nested(count: int):
    """Instances inside each other, each half as large as the one around it and as thick."""
    volumes = [(moved(CLOUD, 0.5**n * np.eye(3)), Medium(30.0 * 2.0**n, 0.95, 0.5)) for n in range(count)]
    layer = render(volumes, [SUN], VIEW, Settings(4))
    around = plain().alpha - layer.alpha
    return Outcome({"unsound": unsound(layer), "lost alpha": float(around.max())}, layer.rgb / layer.rgb.max())


def nearly_white():
    """Albedo 1 - 1e-7 and 1."""
    one, less = (draw(medium=Medium(30.0, a, 0.5)).rgb for a in (1.0, 1.0 - 1e-7))
    return Outcome({"largest": float(np.abs(one - less).max() / one.mean())})


def coloured():
    """Albedo 1, 0.5 and 0 by channel, against grey ones."""
    albedo = (1.0, 0.5, 0.0)
    layer = draw(medium=Medium(30.0, albedo, 0.5))
    greys = np.stack([draw(medium=Medium(30.0, a, 0.5)).rgb[..., i] for i, a in enumerate(albedo)], axis=-1)
    return Outcome(
        {"unsound": unsound(layer), "largest": float(np.abs(layer.rgb - greys).max() / greys.mean())},
        layer.rgb / layer.rgb.max(),
    )


def large_image():
    """8192 × 8192 pixels, one in 10 000 of which shows something, against that part rendered alone."""
    view = camera(pixels=8192, fov=2.9)
    whole = draw(view=view, settings=Settings(1))
    rows, columns = np.nonzero(whole.alpha)
    part = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
    alone = draw(view=replace(view, region=part), settings=Settings(1))
    strips = [slice(top, top + 256) for top in range(0, 8192, 256)]
    names = ("rgb", "single", "multiple", "alpha", "uncertainty", "depth")
    bad = sum(unsound(replace(whole, **{name: getattr(whole, name)[rows] for name in names})) for rows in strips)
    same_rgb = whole.rgb[part[1] : part[3], part[0] : part[2]]
    return Outcome({"unsound": bad, "largest": float(np.abs(same_rgb - alone.rgb).max() / alone.rgb.mean())})


def black():
    layer = draw(medium=Medium(30.0, 0.0, 0.5))
    return Outcome({"unsound": unsound(layer), "light": float(layer.rgb.max())})


def bounded(**changed):
    """At most what the largest fluence of a conservative medium scatters at the phase function's peak."""

    def measure():
        layer = draw(**changed)
        medium = changed.get("medium", MEDIUM)
        g = float(np.clip(abs(medium.anisotropy), 0.0, 0.95))
        most = MAX_FLUENCE * henyey_greenstein(1.0, g)
        told = bool(layer.report.warnings) or abs(medium.anisotropy) <= 0.95
        return Outcome(
            {
                "unsound": unsound(layer),
                "share of the most": float(layer.multiple.max() / most),
                "not told": float(not told),
            },
            layer.rgb / max(layer.rgb.max(), 1e-30),
        )

    return measure


def thin_slope():
    """Multiple scattering at optical densities 1e-3 and 1e-5: linear."""
    points, omega = np.zeros((1, 3)), [(0.0, 0.0, -1.0)]
    a, b = (predict_multiple(CLOUD, Medium(s, 1.0, 0.5), SUN, points, omega)[0, 0] for s in (1e-3, 1e-5))
    return Outcome({"ratio": float(abs(a / (100.0 * b) - 1.0))})


def thin_truth():
    """Multiple scattering alone at an optical density below the trained range, against the path tracer's."""
    from training.reference import PathTracer

    register_system("1024 paths", lambda: PathTracer(1024))
    found, truth = (
        draw(medium=Medium(0.1, 1.0, 0.5), settings=Settings(8, model)).multiple.mean()
        for model in ("mrpnn", "1024 paths")
    )
    return Outcome({"bias": float(abs(found / truth - 1.0))})


def more_depths():
    """Error against 512 depth samples falls at least as 1/N."""
    truth = draw(settings=Settings(512)).multiple
    error = [np.sqrt(((draw(settings=Settings(n)).multiple - truth) ** 2).mean()) for n in (4, 32)]
    return Outcome({"32 over 4 samples": float(error[1] / error[0])})


def furnace(anisotropy: float):
    """Albedo 1 under an even sky of radiance 1 looks like the sky, which 14 suns approximate."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [tuple(sign * (i == axis) for i in range(3)) for axis in range(3) for sign in (-1, 1)]
    # The weights of the quadrature that integrates polynomials of degree 5 over the sphere.
    suns = [Sun(d, 4 * np.pi * 3 / 40) for d in corners] + [Sun(d, 4 * np.pi / 15) for d in faces]

    def measure():
        layer = draw(medium=Medium(30.0, 1.0, anisotropy), suns=suns)
        seen = layer.alpha > 0.02
        ratio = float(layer.rgb.mean(axis=2)[seen].sum() / layer.alpha[seen].sum())
        return Outcome(
            {"unsound": unsound(layer), "returned over received": ratio, "missing": 1.0 - ratio},
            layer.rgb / layer.rgb.max(),
        )

    return measure


def traced(**changed):
    """The network's picture against two independent halves by the path tracer, whose noise does not count."""

    def measure():
        from training.reference import PathTracer

        register_system("64 paths", lambda: PathTracer(64))
        layer = draw(**changed, settings=Settings(16))
        a, b = (draw(**changed, settings=Settings(16, "64 paths", seed)).rgb for seed in (1, 2))
        seen = layer.alpha > 0.5 * layer.alpha.max()
        return Outcome(
            {
                "unsound": unsound(layer),
                "relative RMSE": relative_rmse(layer.rgb, a, b, seen).value,
                "bias": abs(relative_bias(layer.rgb, a, b, seen).value),
            },
            layer.rgb / layer.rgb.max(),
        )

    return measure


SAME = {"unsound": 0.0, "largest": 1e-3}
BOUNDED = {"unsound": 0.0, "share of the most": 1.0, "not told": 0.0}
TRACED = {"unsound": 0.0, "relative RMSE": 0.4, "bias": 0.25}
AHEAD, BEHIND = (Sun(sign * VIEW.world_matrix[:3, 2]) for sign in (-1.0, 1.0))

NESTED = {"unsound": 0.0, "lost alpha": 1e-3}
CASES = [
    Case(
        "law",
        "linear in irradiance: 1e8",
        "itself",
        lambda: same(draw(suns=(Sun(SUN.direction, 1e8),)), 1e8),
        {"unsound": 0.0, "largest": 1e-5},
        True,
    ),
    Case(
        "law",
        "linear in irradiance: 1e-6",
        "itself",
        lambda: same(draw(suns=(Sun(SUN.direction, 1e-6),)), 1e-6),
        {"unsound": 0.0, "largest": 1e-5},
    ),
    Case("law", "the whole scene turned", "itself", turned, SAME),
    *(
        Case("law", f"the whole scene scaled by {k:g}", "itself", functools.partial(resized, k), SAME)
        for k in (1e-6, 1e6)
    ),
    Case("law", "the whole scene moved by 1e7", "itself", far_away, SAME),
    Case("instances", "3 at one place", "one", functools.partial(at_one_place, 3), {"unsound": 0.0, "largest": 0.02}),
    Case(
        "instances",
        "60 at one place, joined",
        "one",
        functools.partial(at_one_place, 60),
        {"unsound": 0.0, "largest": 0.1},
        True,
    ),
    Case("instances", "12 inside each other", "the largest", functools.partial(nested, 12), NESTED),
    Case("law", "albedo 1 − 1e-7 is albedo 1", "itself", nearly_white, {"largest": 1e-4}),
    Case("law", "albedo 1, 0.5 and 0 by channel", "grey ones", coloured, {"unsound": 0.0, "largest": 1e-5}, True),
    Case("law", "8192 × 8192 pixels", "a part alone", large_image, {"unsound": 0.0, "largest": 1e-5}),
    Case("law", "albedo 0 is black", "closed form", black, {"unsound": 0.0, "light": 0.0}, True),
    Case("law", "multiple scattering is linear in a thin medium", "closed form", thin_slope, {"ratio": 1e-3}),
    Case("law", "multiple scattering at σ̂ = 0.1", "path tracer", thin_truth, {"bias": 0.25}),
    Case("law", "more depth samples", "512 samples", more_depths, {"32 over 4 samples": 0.2}),
    *(
        Case(
            "law",
            f"white furnace, G = {g:g}",
            "closed form",
            furnace(g),
            {"unsound": 0.0, "returned over received": 1.17, "missing": 0.17},
        )
        for g in (0.0, 0.5)
    ),
    *(
        Case("bounded", name, "conservative half-space", bounded(**changed), BOUNDED, quick)
        for name, changed, quick in (
            ("σ̂ = 1e-6", {"medium": Medium(1e-6, 1.0, 0.5)}, False),
            ("σ̂ = 1e7", {"medium": Medium(1e7, 1.0, 0.5)}, True),
            ("G = 0.999, sun in front", {"medium": Medium(30.0, 1.0, 0.999), "suns": (AHEAD,)}, False),
            ("G = −0.999, sun behind", {"medium": Medium(30.0, 1.0, -0.999), "suns": (BEHIND,)}, False),
        )
    ),
    *(
        Case("path tracer", name, "path tracer", traced(**changed), TRACED)
        for name, changed in (
            ("σ̂ = 0.01", {"medium": Medium(0.01, 1.0, 0.5)}),
            ("σ̂ = 1000", {"medium": Medium(1000.0, 0.99, 0.5)}),
            ("γ = 0", {"suns": (AHEAD,)}),
            ("γ = π", {"suns": (BEHIND,)}),
            ("albedo 0.1", {"medium": Medium(30.0, 0.1, 0.5)}),
            ("G = −0.3", {"medium": Medium(30.0, 0.95, -0.3)}),
            ("G = 0.95", {"medium": Medium(30.0, 0.95, 0.95)}),
        )
    ),
]
