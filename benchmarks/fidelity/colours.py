# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering where the albedo varies in space, and scattered emission, against traced paths.

    python -m benchmarks.fidelity.colours [--emission] [--size 16] [--paths 1024] [--anisotropies 0 0.857]

Each volume, of a seed that no network has learnt from, has two colours that meet in one way: in the patches of smoke,
along an axis, in the sharp patches of soot, or with the density. It is seen by one orthographic camera in the light of
two suns. Paths start where camera rays scatter first, at random in equal parts of a ray's opacity. RMSE is relative to
the mean and without the paths' noise, of all three channels, and a mean over the suns. Biases are those of each
channel's images, and ± is the largest of their standard errors.

With --emission, volumes of albedo 0.9 light themselves: parts of them glow, or a flame burns in them or beside them.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from inference import Camera, Medium, Settings, Sun, Volume, render
from inference.scene.optimizations import ALL
from training.data.light_scene import EMISSIONS, _flame, _glowing_density, _noise, _points, _smoothstep
from training.procedural.seeded_volume import cube_volume
from training.procedural.volumes import make_volume
from training.tracer.density_grid import prepare
from training.tracer.light_paths import AlbedoField, Lights, LitMedium, trace_lights
from training.tracer.path_tracer import Sampling

from ..support.provenance import made_by

PROGRAM = "benchmarks.fidelity.colours"
#: First seed of the volumes, and their cells along an edge.
SEED, CELLS = 1_000_400, 96
#: Albedos of both colours, by how they meet.
COLOURS = {
    "smoke": ((0.95, 0.35, 0.25), (0.2, 0.45, 0.95)),
    "dyes": ((0.97, 0.7, 0.25), (0.2, 0.6, 0.97)),
    "soot": ((0.99, 0.99, 0.99), (0.1, 0.3, 0.5)),
    "density": ((0.9, 0.9, 0.9), (0.7, 0.35, 0.15)),
}
#: Seeds of the volumes that emit, their extinction where the density is 1, per cube edge, and their albedo.
GLOWING, SIGMAS, ALBEDO = range(1_000_420, 1_000_424), (20.0, 150.0), 0.9
#: Vertices on each ray, and steps along an edge of the cube by which its opacity is known.
VERTICES, STEPS = 16, 256
#: Every pixel is predicted by itself.
SETTINGS = Settings(32, threads=1, optimizations=ALL - {"shared_pixels"})
#: Opacity above which a pixel shows the volume.
MIN_ALPHA = 0.02


@dataclass(frozen=True)
class Coloured:
    """density, mask: (N, N, N), the mask 0 where the albedo is `low` (3,) and 1 where it is `high` (3,).

    sigma: extinction per cube edge where the density is 1. suns: (2, 3). view: (3, 3), right, up and backwards.
    """

    density: np.ndarray
    mask: np.ndarray
    low: np.ndarray
    high: np.ndarray
    sigma: float
    suns: np.ndarray
    view: np.ndarray

    @classmethod
    def of(cls, kind: str) -> "Coloured":
        """One of COLOURS."""
        number = list(COLOURS).index(kind)
        density = make_volume(SEED + number, CELLS).density
        random = np.random.default_rng([SEED + number, 5])
        masks = {
            "smoke": lambda: _smoothstep(_noise(random, CELLS, 2) / 1.2 + 0.5),
            "dyes": lambda: _smoothstep((_points(CELLS) @ [0.8, 0.6, 0.0]).reshape(density.shape) / 0.1 + 0.5),
            "soot": lambda: _smoothstep(_noise(random, CELLS, 3) / 0.3 + 0.5),
            "density": lambda: np.sqrt(density),
        }
        mask = masks[kind]().astype(np.float32)
        suns = random.normal(size=(2, 3))
        view = np.linalg.qr(random.normal(size=(3, 3)))[0].T
        low, high = np.array(COLOURS[kind], np.float32)
        suns /= np.linalg.norm(suns, axis=1, keepdims=True)
        return cls(density, mask, low, high, float(random.uniform(25.0, 90.0)), suns, view * np.linalg.det(view))

    @property
    def albedo(self) -> np.ndarray:
        """float32 (N, N, N, 3)."""
        return self.low + self.mask[..., None] * (self.high - self.low)

    def camera(self, size: int) -> Camera:
        """Orthographic, and as wide as the cube."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.view.T, 4.0 * self.view[2]
        return Camera(matrix, "orthographic", (size, size), ortho_scale=1.0)

    def read(self, values: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Values of cells (N, N, N), interpolated at positions (..., 3), and 0 outside."""
        at = np.moveaxis((positions + 0.5) * CELLS - 0.5, -1, 0)
        return map_coordinates(np.pad(values, 1), at + 1.0, order=1, mode="constant")

    def vertices(self, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Where rays of pixels scatter first, (size, size, VERTICES, 3), and their opacity (size, size)."""
        across = (np.arange(size) + 0.5) / size - 0.5
        start = across[None, :, None] * self.view[0] - across[:, None, None] * self.view[1] + self.view[2]
        lengths = np.arange(2 * STEPS + 1) / STEPS
        density = self.read(self.density, start[:, :, None] - lengths[:, None] * self.view[2])
        depth = np.cumsum(density, axis=2) * (self.sigma / STEPS)
        depth = np.concatenate([np.zeros((size, size, 1)), depth], axis=2)
        opacity = -np.expm1(-depth[..., -1])
        share = (np.arange(VERTICES) + np.random.default_rng(1).random((size, size, VERTICES))) / VERTICES
        wanted, places = -np.log1p(-share * opacity[..., None]), np.append(0.0, lengths + 0.5 / STEPS)
        found = np.empty_like(wanted)
        for pixel in np.ndindex(size, size):
            found[pixel] = np.interp(wanted[pixel], depth[pixel], places)
        return np.clip(start[:, :, None] - found[..., None] * self.view[2], -0.5, 0.5), opacity

    def seen(self, size: int) -> np.ndarray:
        """Whether pixels show the volume, bool (size, size)."""
        return self.vertices(size)[1] > MIN_ALPHA

    @property
    def field(self) -> AlbedoField:
        """The albedo, for the tracer."""
        return AlbedoField(self.low, self.high, self.mask)

    def lights(self, emission: np.ndarray | None = None) -> Lights:
        """The suns and fields of emission (N, N, N, E)."""
        none = np.zeros((*self.density.shape, 0), np.float32)
        return Lights(self.suns, (), np.zeros((0, 2, 4), np.float32), none if emission is None else emission)


def traced(scene: Coloured, lights: Lights, anisotropy: float, size: int, paths: int) -> np.ndarray:
    """Images (2, K, size, size, 3) in K lights, in two independent halves.

    Of suns, multiple scattering; of emission, all that is scattered.
    """
    positions, opacity = scene.vertices(size)
    omega = np.broadcast_to(-scene.view[2], positions.shape).reshape(-1, 3)
    mask = scene.read(scene.mask * scene.density, positions) / np.maximum(scene.read(scene.density, positions), 1e-12)
    albedo = scene.low + np.clip(mask, 0.0, 1.0)[..., None] * (scene.high - scene.low)
    grid, medium = prepare(scene.density), LitMedium(scene.sigma, anisotropy, scene.field)
    halves = []
    for seed in range(2):
        sampling = Sampling(max(paths // (2 * VERTICES), 1), seed)
        light, once = trace_lights(grid, lights, medium, (positions.reshape(-1, 3), omega), sampling)
        light[:, len(scene.suns) :] += once[..., None]
        light = light.reshape(size, size, VERTICES, lights.count, 3)
        scattered = (light * albedo[:, :, :, None]).mean(axis=2) * opacity[..., None, None]
        halves.append(np.moveaxis(scattered, 2, 0))
    return np.array(halves)


def shown(scene: Coloured, anisotropy: float, size: int) -> np.ndarray:
    """The renderer's images (S, size, size, 3)."""
    volume, medium = cube_volume(scene.density), Medium(scene.sigma, scene.albedo, anisotropy)
    suns = [Sun(sun, 1.0) for sun in scene.suns]
    return np.array([render([(volume, medium)], [sun], scene.camera(size), SETTINGS).multiple for sun in suns])


def shown_glow(scene: Coloured, emission: np.ndarray, anisotropy: float, size: int) -> np.ndarray:
    """The renderer's images (E, size, size, 3) of emission (N, N, N, E)."""
    volume, medium, images = cube_volume(scene.density), Medium(scene.sigma, ALBEDO, anisotropy), []
    for field in np.moveaxis(emission, 3, 0):
        grey = np.repeat(field[..., None], 3, axis=3)
        glowing = Volume(volume.density, volume.world_from_index, volume.name, grey)
        images.append(render([(glowing, medium)], [], scene.camera(size), SETTINGS).multiple)
    return np.array(images)


def compare(images: np.ndarray, halves: np.ndarray, seen: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Mean relative RMSE of lights without noise, biases (3,) of channels, and the largest standard error of these.

    images: (K, size, size, 3). seen: bool (size, size), the pixels that count.
    """
    images, a, b = images[:, seen], *halves[:, :, seen]
    mean = 0.5 * (a + b).mean(axis=1)
    square = ((images - a) * (images - b)).mean(axis=(1, 2))
    bias = images.mean(axis=1) / mean - 1.0
    error = 0.5 * (a - b).std(axis=1) / mean / np.sqrt(seen.sum())
    return float((np.sqrt(np.maximum(square, 0.0)) / mean.mean(axis=1)).mean()), bias.mean(axis=0), error.max()


def coloured(arguments: argparse.Namespace) -> None:
    """Print the table of varying albedos."""
    print("| colours | G | extinction | RMSE | bias of red | of green | of blue | ± |")
    print("|---|---|---|---|---|---|---|---|")
    for kind in COLOURS:
        scene = Coloured.of(kind)
        for anisotropy in arguments.anisotropies:
            halves = traced(scene, scene.lights(), anisotropy, arguments.size, arguments.paths)
            rmse, biases, error = compare(shown(scene, anisotropy, arguments.size), halves, scene.seen(arguments.size))
            means = " | ".join(f"{bias:+.1%}" for bias in biases)
            print(f"| {kind} | {anisotropy:g} | {scene.sigma:.0f} | {rmse:.3f} | {means} | {error:.1%} |", flush=True)


def glowing(arguments: argparse.Namespace) -> None:
    """Print the table of emission."""
    print("| volume | G | extinction | emission | RMSE | bias | ± |")
    print("|---|---|---|---|---|---|---|")
    for seed in GLOWING:
        random, density = np.random.default_rng([seed, 9]), make_volume(seed, CELLS).density
        emission = np.stack([_glowing_density(random, density), _flame(random, density)], axis=3)
        view = np.linalg.qr(random.normal(size=(3, 3)))[0].T
        even, white = np.zeros_like(density), np.full(3, ALBEDO, np.float32)
        for sigma in SIGMAS:
            scene = Coloured(density, even, white, white, sigma, np.zeros((0, 3)), view * np.linalg.det(view))
            for anisotropy in arguments.anisotropies:
                halves = traced(scene, scene.lights(emission), anisotropy, arguments.size, arguments.paths)
                images = shown_glow(scene, emission, anisotropy, arguments.size)
                for number, name in enumerate(EMISSIONS):
                    here = slice(number, number + 1)
                    rmse, bias, error = compare(images[here], halves[:, here], scene.seen(arguments.size))
                    facts = f"| {seed} | {anisotropy:g} | {sigma:.0f} | {name} |"
                    print(f"{facts} {rmse:.3f} | {bias.mean():+.1%} | {error:.1%} |", flush=True)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--emission", action="store_true", help="light that volumes emit and scatter")
    parser.add_argument("--size", type=int, default=16, help="pixels along an edge")
    parser.add_argument("--paths", type=int, default=1024, help="per pixel, of both halves together")
    parser.add_argument("--anisotropies", type=float, nargs="+", default=[0.0, 0.857])
    arguments = parser.parse_args(options)
    print(made_by(PROGRAM, options))
    (glowing if arguments.emission else coloured)(arguments)


if __name__ == "__main__":
    main()
