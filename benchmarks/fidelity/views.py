# SPDX-License-Identifier: GPL-3.0-or-later
"""The views that systems are measured on: what is seen, from where, in what light, and its reference.

Cube units: the volume fills [-1/2, 1/2]^3, the camera looks at the origin, the sun has irradiance 1.
"""

import functools
import pathlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from inference import Camera, Medium, Settings, Sun, render
from training.procedural.seeded_volume import cube_volume
from training.procedural.volumes import HELD_BACK, make_volume

from ..support.data import REFERENCES
from .references import traced_halves

# The references leave out some faint pixels; those count that show the medium.
MASK_ALPHA = 0.02
LIGHTS = ("side", "front", "back")
#: Held-back seeds, none of them among those that training validates on: two cumuli, simulated smoke, a plume,
#: solids cut from one another, a homogeneous solid.
VOLUMES = {
    name: HELD_BACK[i]
    for name, i in {"cloud1": 503, "cloud2": 520, "cloud3": 506, "cloud4": 504, "model1": 516, "model2": 507}.items()
}
#: Of these, the ones whose albedo and anisotropy are varied.
VARIED = ("cloud1", "model1")
GREY = (1.0, 1.0, 1.0)
ALBEDOS = (GREY, (0.96, 0.98, 1.0), (0.8, 0.9, 1.0))
ANISOTROPIES = (0.857, 0.5, 0.0)
SIGMA_HAT = 100.0
FOV = 40.0
#: Ends the names of independent views whose references are traced anew.
RETRACED = "-retraced"
POSITION = (1.1, -0.95, 0.45)


@dataclass(frozen=True)
class ViewSpec:
    """What a view shows, and the size of its reference.

    volume: its name. light: one of LIGHTS. sigma_hat: optical thickness of the cube's edge at density 1.
    albedo: one value per channel. size: pixels per edge. samples: paths per pixel in each half of the reference.
    """

    volume: str
    light: str
    sigma_hat: float = SIGMA_HAT
    albedo: tuple[float, float, float] = GREY
    anisotropy: float = ANISOTROPIES[0]
    size: int = 64
    samples: int = 1024


@dataclass(frozen=True, eq=False)
class View:
    """One image to be predicted.

    density: () -> float32 (n, n, n). sun, position, up: (3,), cube units. fov: degrees.
    reference: (View) -> float64 (2, H, W, 4), radiance and alpha of two independent halves.
    """

    name: str
    spec: ViewSpec
    density: Callable
    sun: np.ndarray
    position: np.ndarray
    up: tuple[float, float, float]
    fov: float
    reference: Callable

    def halves(self) -> np.ndarray:
        """float64 (2, H, W, 4): radiance and alpha of two independent references of `spec.samples` paths per pixel."""
        return self.reference(self)

    def camera(self, size: int) -> Camera:
        """Square, `size` pixels per edge."""
        return Camera(look_at(self.position, self.up), resolution=(size, size), fov=np.radians(self.fov))

    def volumes(self) -> list:
        """What `inference.render` takes: the volume with its medium."""
        medium = Medium(self.spec.sigma_hat, self.spec.albedo, self.spec.anisotropy)
        return [(cube_volume(self.density(), self.spec.volume), medium)]

    def render(self, settings: Settings, size: int = None):
        """The layer of this view; size: pixels per edge, the reference's without."""
        return render(self.volumes(), [Sun(self.sun, 1.0)], self.camera(size or self.spec.size), settings)


def look_at(position, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    """Camera to world (4, 4) for a camera at `position` that looks at the origin."""
    position = np.asarray(position, np.float64)
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = right, np.cross(right, forward)
    matrix[:3, 2], matrix[:3, 3] = -forward, position
    return matrix


@functools.lru_cache(1)
def independent_density(name: str) -> np.ndarray:
    """float32 (N, N, N), largest value 1: the density of an independent reference's volume, its second axis up."""
    with np.load(REFERENCES / "volumes" / f"{name}.npz") as data:
        return data["density"].astype(np.float32) / data["largest"]


def _independent_view(path: pathlib.Path) -> View:
    with np.load(path) as data:
        facts = {key: data[key] for key in data.files if key != "ab"}
        size = data["ab"].shape[1]

    def halves(view):
        with np.load(path) as data:
            return data["ab"].astype(np.float64)

    volume, _, light = path.stem.split("-")[:3]
    spec = ViewSpec(
        volume,
        light,
        float(facts["sigma"]),
        tuple(round(float(value), 6) for value in facts["albedo"]),
        round(float(facts["g"]), 6),
        size,
        int(facts["spp"]),
    )
    return View(
        path.stem,
        spec,
        functools.partial(independent_density, volume),
        facts["sun"],
        facts["cam"],
        (0.0, 1.0, 0.0),
        float(facts["fov"]),
        halves,
    )


def independent_views() -> list:
    """Those of benchmarks/data/references, whose path tracer shares no code with the project."""
    return [_independent_view(path) for path in sorted((REFERENCES / "views").glob("*.npz"))]


def retraced_views(samples: int, folder: pathlib.Path) -> list:
    """`independent_views` with less noisy references, which the project's own path tracer makes and keeps in `folder`.

    samples: paths per pixel in each half.
    """
    reference = functools.partial(traced_halves, folder=folder)
    return [
        replace(view, name=view.name + RETRACED, spec=replace(view.spec, samples=samples), reference=reference)
        for view in independent_views()
    ]


@functools.lru_cache(1)
def held_back_density(seed: int, cells: int) -> np.ndarray:
    return make_volume(seed, cells).density


def sun_direction(light: str, position=POSITION, up=(0.0, 0.0, 1.0)) -> np.ndarray:
    """Unit vector towards a sun at the side of, in front of (the camera's side) or behind the volume."""
    right, above, backward = look_at(position, up)[:3, :3].T
    direction = {
        "side": 0.9 * right + 0.4 * above + 0.1 * backward,
        "front": 0.2 * right + 0.35 * above + 0.9 * backward,
        "back": 0.3 * right + 0.4 * above - 0.85 * backward,
    }[light]
    return direction / np.linalg.norm(direction)


def traced_view(name: str, spec: ViewSpec, density: Callable, folder: pathlib.Path) -> View:
    """A view whose reference the project's own path tracer makes and keeps in `folder`.

    density: () -> float32 (n, n, n), its third axis up.
    """
    reference = functools.partial(traced_halves, folder=folder)
    return View(name, spec, density, sun_direction(spec.light), np.array(POSITION), (0.0, 0.0, 1.0), FOV, reference)


def procedural_view(spec: ViewSpec, cells: int, folder: pathlib.Path) -> View:
    """A held-back volume, one of VOLUMES; cells: along an edge of it."""
    name = f"{spec.volume}-{spec.light}-g{spec.anisotropy:g}-albedo{spec.albedo[0]:g}"
    return traced_view(name, spec, functools.partial(held_back_density, VOLUMES[spec.volume], cells), folder)


def procedural_views(size: int, samples: int, cells: int, folder: pathlib.Path) -> list:
    """Table 1's views of every held-back volume and Table 2's of some.

    size: pixels per edge; samples: paths per pixel in each half; cells: along an edge of the volumes; folder: of
    references.
    """
    wanted = [(volume, light, GREY, ANISOTROPIES[0]) for volume in VOLUMES for light in LIGHTS]
    for volume in VARIED:
        wanted += [(volume, light, albedo, ANISOTROPIES[0]) for albedo in ALBEDOS[1:] for light in LIGHTS]
        wanted += [(volume, light, GREY, g) for g in ANISOTROPIES[1:] for light in LIGHTS]
    # Views of one volume together: the density made last is cached.
    wanted.sort(key=lambda facts: facts[0])
    specs = [ViewSpec(volume, light, SIGMA_HAT, albedo, g, size, samples) for volume, light, albedo, g in wanted]
    return [procedural_view(spec, cells, folder) for spec in specs]
