# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against run time at the sizes of real images: makes docs/tables/real-sizes*.csv.

    python -m benchmarks.error_vs_time.real_sizes [--only WORDS] [--most SAMPLES] [--references] [--table]

The scenes are those of `real_scenes`. References and Cycles' images, each with its processor seconds, are kept in
data/real_sizes, so that a run that was stopped continues where it was; the layer is rendered again for other code or
weights. Run it with bpy 4.5 and with 5.2, which has two ways through volumes. Everything runs on one thread.
"""

import argparse
import functools
import re
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evaluation.error import RESAMPLES, Estimate, error_text, relative_bias, tile_sums
from evaluation.error_vs_time import AT_LEAST, AT_MOST, Rung, cost, seconds_on_ladder
from inference import Settings
from mrpnn_addon.comparison.perceptual import flip

from ..fidelity.tables import table
from ..fidelity.views import MASK_ALPHA
from ..support.pages import TABLES, csv_text, replace, write_tables
from ..support.provenance import made_by
from .real_scenes import SCENES, SKY_COLOUR, SKY_HEIGHTS, SKY_RADIANCE, RealScene, halves, trace, traced

PROGRAM = "benchmarks.error_vs_time.real_sizes"
LADDER, NOISY, ALL_BOUNCES = (1, 4, 16, 64), 4, 1024
SMALL_ROWS = 512
SMALL = [scene for scene in SCENES if scene.rows == SMALL_ROWS]
#: Names of the rows of whichever method is quickest in a scene: without denoising, and denoised.
QUICKEST = ("the quickest of these", "the quickest of these, denoised")
#: Rows of the largest images of which FLIP is computed.
FLIP_ROWS, MOST_FLIP_NOISE = 512, 0.1
FIRST, NEXT = "MRPNN layer, first frame", "MRPNN layer, next frame"
COLUMNS = ("scene", "method", "samples", "rmse", "rmse_low", "rmse_high", "bias", "cpu_seconds", "flip", "flip_noise")


def file_of(scene: RealScene, method: str, samples: int) -> Path:
    """Where an image is kept."""
    return scene.folder / "images" / scene.name / f"{method}, {samples}.npz"


def keep(path: Path, image: np.ndarray, seconds: float, source: str) -> None:
    """Store an image (H, W, 3) with its processor seconds and the sentence on what made it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    with open(partial, "wb") as file:
        np.savez(file, image=np.asarray(image, np.float32), seconds=seconds, made_by=source)
    partial.replace(path)


def source_of(path: Path) -> str:
    """The sentence on what made a stored image, "" where there is none."""
    if not path.exists():
        return ""
    with np.load(path) as data:
        return str(data["made_by"])


def stage(scene: RealScene, folder: Path):
    """The scene in Blender."""
    import bpy

    from ..cycles.baked_light import stage as staged
    from ..support.shaders import add_sky

    made = staged(scene.view(), folder)
    made.render.resolution_y = scene.rows
    made.render.threads_mode, made.render.threads = "FIXED", 1
    if scene.sky:
        add_sky(made.world, SKY_COLOUR, SKY_HEIGHTS, SKY_RADIANCE)
    bpy.context.view_layer.update()
    return made


def render_images(scene: RealScene, most: int, source: str) -> None:
    """Render the layer, and of Cycles what is not there, up to `most` samples."""
    import bpy
    from mrpnn.mrpnn_addon.cycles.choices import Choice

    from ..cycles.settings import layers, picture

    version = f"Cycles {bpy.app.version_string.removesuffix(' LTS')}"
    with tempfile.TemporaryDirectory() as folder:
        made = stage(scene, Path(folder))
        if source_of(file_of(scene, NEXT, Settings.depth_samples)) != source:
            for name, image, seconds in layers(Settings(threads=1)):
                keep(file_of(scene, name, Settings.depth_samples), image, seconds, source)
        for null in (False, True) if hasattr(made.cycles, "volume_biased") else (False,):
            way = f"{version}, null scattering" if null else version
            wanted = [(f"{way}, denoised", samples, True) for samples in LADDER] + [(way, NOISY, False)]
            for method, samples, denoised in sorted(wanted, key=lambda one: one[1]):
                path = file_of(scene, method, samples)
                if samples <= most and not path.exists():
                    choice = Choice(ALL_BOUNCES, denoised, null)
                    keep(path, *picture(made, Path(folder), choice, samples), source)
                    print(f"{scene.name}: {method}, {samples}", flush=True)


class Image(NamedTuple):
    """One image of a scene: what made it, samples, linear radiance (H, W, 3), processor seconds."""

    method: str
    samples: int
    pixels: np.ndarray
    seconds: float


def images(scene: RealScene) -> Iterator[Image]:
    """Those that are kept."""
    for path in sorted((scene.folder / "images" / scene.name).glob("*.npz")):
        method, samples = path.stem.rsplit(", ", 1)
        with np.load(path) as data:
            yield Image(method, int(samples), data["image"].astype(np.float64), float(data["seconds"]))


class Measured:
    """One scene's images against its reference.

    rungs: by method, by ascending samples. draws: of each image, by method and samples, its relative RMSE
    (1 + RESAMPLES,): as it is, then with the reference's tiles resampled, the same for all images of the scene.
    flip_noise: FLIP of the reference's own noise, by that of one half beside the mean, where it is small. All FLIP is
    within the rectangle around the pixels that show the volume.
    """

    def __init__(self, scene: RealScene, pair: np.ndarray, found: Iterable[Image], flips: bool = True):
        """pair: (2, H, W, 4), independent references of radiance and alpha."""
        mask = pair[..., 3].mean(axis=0) > MASK_ALPHA
        self.scene, (a, b) = scene, pair[..., :3] * mask[..., None]
        mean, shown = (a + b) / 2, tile_sums(mask.astype(float)) > 0
        drawn = np.random.default_rng(0).integers(0, shown.sum(), size=(RESAMPLES, shown.sum()))

        def sums(values):
            tiles = tile_sums(values)[shown]
            return np.concatenate([[tiles.sum()], tiles[drawn].sum(axis=1)])

        count, brightness = sums(mask.astype(float)), sums(mean.mean(axis=-1))
        # FLIP takes seconds, and tells nothing where the reference is noisy.
        box = tuple(slice(where.min(), where.max() + 1) for where in np.nonzero(mask))
        noise = flip(a[box], mean[box]) if flips else None
        self.flip_noise = None if noise is None or noise > MOST_FLIP_NOISE else noise
        self.rungs: dict[str, list[Rung]] = {}
        self.draws: dict[tuple[str, int], np.ndarray] = {}
        for method, samples, pixels, seconds in found:
            image = pixels * mask[..., None]
            squares = sums(((image - a) * (image - b)).mean(axis=-1))
            errors = np.sqrt(np.maximum(squares / count, 0.0)) / (brightness / count)
            self.draws[method, samples] = errors
            rmse = Estimate(errors[0], *np.percentile(errors[1:], [2.5, 97.5]))
            perceived = None if self.flip_noise is None else flip(image[box], mean[box])
            bias = relative_bias(image, a, b, mask)
            rung = Rung(method, samples, float("nan"), seconds, 0.0, 0.0, rmse, bias, perceived)
            self.rungs.setdefault(method, []).append(rung)
        for rungs in self.rungs.values():
            rungs.sort(key=lambda rung: rung.samples)

    def ratio_methods(self) -> list[str]:
        """The methods that `ratios` can be told of."""
        return [method for method in self.rungs if method.startswith("Cycles") and self._denoised(method) in self.rungs]

    @staticmethod
    def _denoised(method: str) -> str:
        return f"{method.removesuffix(', denoised')}, denoised"

    def ratios(self, method: str, of: str) -> tuple[np.ndarray, str]:
        """How many times as long as the layer a method takes to its error, (1 + RESAMPLES,), and how that is known."""
        layer = self.rungs[of][0]
        errors = self.draws[of, layer.samples]
        if method.endswith("denoised"):
            rungs = self.rungs[method]
            draws = np.stack([self.draws[method, rung.samples] for rung in rungs], axis=1)
            with np.errstate(divide="ignore"):
                reached = [_on_ladder(rungs, row, error) for row, error in zip(draws, errors)]
            return np.array([one.value for one in reached]) / layer.cpu_seconds, reached[0].how
        # Noise alone; a sample's seconds are those of the denoised ladder, where more of them were rendered.
        [noisy] = self.rungs[method]
        ladder = self.rungs[self._denoised(method)]
        _, each = cost([rung.samples for rung in ladder], [rung.cpu_seconds for rung in ladder])
        with np.errstate(divide="ignore"):
            samples = noisy.samples * (self.draws[method, noisy.samples] / errors) ** 2
        return samples * each / layer.cpu_seconds, "extrapolated"


def _on_ladder(rungs: Sequence[Rung], errors: Sequence[float], error: float):
    """`seconds_on_ladder` with other errors of the rungs."""
    other = [
        Rung(r.method, r.samples, r.seconds, r.cpu_seconds, 0.0, 0.0, Estimate(e, e, e), r.bias)
        for r, e in zip(rungs, errors)
    ]
    return seconds_on_ladder(other, error, "cpu_seconds")


def number(value: float) -> str:
    """Three digits."""
    if not np.isfinite(value):
        return "beyond telling"
    return f"{float(f'{value:.3g}'):,.0f}".replace(",", " ") if value >= 100.0 else f"{value:.3g}"


def span(values: np.ndarray, how: str = "") -> str:
    """A ratio and its interval."""
    low, high = np.quantile(values[1:], [0.025, 0.975], method="nearest")
    sign = {AT_LEAST: "≥ ", AT_MOST: "≤ "}.get(how, "") if np.isfinite(values[0]) else ""
    return f"{sign}{number(values[0])} ({number(low)}–{number(high)})"


def section(measured: list[Measured]) -> str:
    """The tables: geometric means, then every scene."""
    small = [one for one in measured if one.scene.rows == SMALL_ROWS]
    methods = sorted({method for one in measured for method in one.ratio_methods()})
    means = []
    for denoised in (False, True):
        own = [method for method in methods if method.endswith("denoised") == denoised]
        for name, several in [(method, [method]) for method in own] + [(QUICKEST[denoised], own)]:
            for of in (FIRST, NEXT):
                # Of several methods the quickest one of each scene, resample by resample.
                found = [
                    [one.ratios(method, of) for method in several if method in one.ratio_methods()] for one in small
                ]
                ratios = [np.min([values for values, _ in each], axis=0) for each in found if each]
                if ratios:
                    mean = np.exp(np.mean(np.log(ratios), axis=0))
                    how = AT_LEAST if any(how == AT_LEAST for each in found for _, how in each) else ""
                    means.append([name, of.rpartition(", ")[2], span(mean, how), f"{len(ratios)} of {len(SMALL)}"])
    summary = table(["against", "the layer's", "geometric mean of times as long", "scenes of 512²"], means)
    head = ["scene", "pixels", "method", "samples", "error", "bias", "processor seconds", "FLIP",
            "times as long to the layer's error, first / next frame"]  # fmt: skip
    return f"{summary}\n{table(head, [row for one in measured for row in image_rows(one)])}".rstrip()


def image_rows(one: Measured) -> Iterator[list[str]]:
    """A row of the page for each image of a scene; ratios are in the last one of a method."""
    size = f"{one.scene.spec.size} × {one.scene.rows}"
    for method, rungs in sorted(one.rungs.items(), key=lambda item: (item[0] not in (FIRST, NEXT), item[0])):
        for rung in rungs:
            known = rung is rungs[-1] and method in one.ratio_methods()
            yield [
                one.scene.name,
                size,
                method,
                str(rung.samples),
                error_text(rung.rmse.value, rung.rmse.low, rung.rmse.high),
                f"{100 * rung.bias.value:+.1f} %",
                f"{rung.cpu_seconds:.3g}",
                _shown_flip(rung, one.flip_noise),
                " / ".join(span(*one.ratios(method, of)) for of in (FIRST, NEXT)) if known else "",
            ]


def _shown_flip(rung: Rung, noise: float | None) -> str:
    """FLIP, where the reference's own noise is below it."""
    if rung.flip is None or noise is None or rung.flip <= noise:
        return ""
    return f"{rung.flip:.3f} (noise {noise:.3f})"


def csv_rows(measured: list[Measured]):
    """A row for each image."""
    for one in measured:
        for rung in (rung for rungs in one.rungs.values() for rung in rungs):
            values = (rung.rmse.value, rung.rmse.low, rung.rmse.high, rung.bias.value, rung.cpu_seconds, rung.flip,
                      one.flip_noise)  # fmt: skip
            shown = ["" if value is None else f"{value:.5g}" for value in values]
            yield [one.scene.name, rung.method, rung.samples, *shown]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.split("\n\n")[0])
    parser.add_argument("--only", default="", metavar="WORDS", help="only scenes whose name contains this")
    parser.add_argument("--most", type=int, default=max(LADDER), metavar="SAMPLES", help="of Cycles, per pixel")
    parser.add_argument("--references", action="store_true", help="trace the references and nothing else")
    parser.add_argument("--table", action="store_true", help="write the page from the images there are")
    options = parser.parse_args(arguments)
    wanted = [scene for scene in SCENES if options.only in scene.name]
    for scene in [] if options.table else wanted:
        trace(scene, scene.spec.samples, functools.partial(print, flush=True))
    if options.references:
        return 0
    if not options.table:
        from ..support.extension import extension

        extension()
        for scene in wanted:
            render_images(scene, options.most, made_by(PROGRAM, arguments))
    write_figures()
    return 0


def folded(sources: set[str]) -> list[str]:
    """Sentences on what made images, those that differ in the commit as one."""
    found: dict[tuple[str, str], set[str]] = {}
    for source in sources:
        before, commit, after = re.fullmatch(r"(.*), commit ([^,]*), (.*)", source).groups()
        found.setdefault((before, after), set()).add(commit)
    sentences = []
    for (before, after), commits in sorted(found.items()):
        plain = ", ".join(sorted({commit.split()[0] for commit in commits}))
        changed = ", some with local changes" if any(" " in commit for commit in commits) else ""
        sentences.append(f"{before}, commit{'s' if ', ' in plain else ''} {plain}{changed}, {after}")
    return sentences


def write_figures() -> None:
    """The CSV files of the scenes that are measured: images, ratios, and images as they are shown."""
    known = [scene for scene in SCENES if traced(scene) and any(images(scene))]
    measured = [Measured(scene, halves(scene), images(scene), scene.rows <= FLIP_ROWS) for scene in known]
    files = [file_of(scene, image.method, image.samples) for scene in known for image in images(scene)]
    sources = folded(set(map(source_of, files)))
    replace(TABLES / "real-sizes.csv", csv_text(sources, COLUMNS, csv_rows(measured)))
    paths = "; ".join(f"{scene.name}: {traced(scene)}" for scene in known)
    said = [f"Paths per pixel in each half of the references: {paths}.", *sources]
    write_tables("real-sizes", section(measured), said)


if __name__ == "__main__":
    sys.exit(main())
