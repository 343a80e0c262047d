# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against run time at the sizes of real images: a section of docs/error-vs-time.md and docs/real-sizes.csv.

    python -m benchmarks.error_vs_time.real_sizes [--only WORDS] [--most SAMPLES] [--references] [--table]

The scenes are those of `real_scenes`. References and Cycles' images, each with its processor seconds, are kept in
data/real_sizes, so that a run that was stopped continues where it was; the layer is rendered again. Run it with bpy 4.5
and with 5.2, which has two ways through volumes. Everything runs on one thread.
"""

import argparse
import functools
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inference import Settings
from inference.evaluation.error import RESAMPLES, Estimate, relative_bias, tile_sums
from inference.evaluation.error_vs_time import AT_LEAST, AT_MOST, Rung, cost, seconds_on_ladder

from ..fidelity.tables import table
from ..fidelity.views import MASK_ALPHA
from ..support.extension import ROOT
from ..support.pages import csv_text, with_table
from ..support.pages import replace as replace_file
from ..support.provenance import made_by
from .real_scenes import FOLDER, SCENES, SKY_COLOUR, SKY_HEIGHTS, SKY_RADIANCE, RealScene, halves, trace, traced

PROGRAM = "benchmarks.error_vs_time.real_sizes"
DOCS = ROOT / "docs"
LADDER, NOISY, ALL_BOUNCES = (1, 4, 16, 64), 4, 1024
FIRST, NEXT = "MRPNN layer, first frame", "MRPNN layer, next frame"
COLUMNS = ("scene", "method", "samples", "rmse", "rmse_low", "rmse_high", "bias", "cpu_seconds", "flip", "flip_noise")


def file_of(scene: RealScene, method: str, samples: int) -> Path:
    """Where an image is kept."""
    return FOLDER / "images" / scene.name / f"{method}, {samples}.npz"


def keep(path: Path, image: np.ndarray, seconds: float, source: str) -> None:
    """Store an image (H, W, 3) with its processor seconds and the sentence on what made it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    with open(partial, "wb") as file:
        np.savez(file, image=np.asarray(image, np.float32), seconds=seconds, made_by=source)
    partial.replace(path)


def stage(scene: RealScene, folder: Path):
    """The scene in Blender."""
    import bpy

    from ..cycles.baked_light import stage as staged

    made = staged(scene.view(), folder)
    made.render.resolution_y = scene.rows
    made.render.threads_mode, made.render.threads = "FIXED", 1
    if scene.sky:
        tree = made.world.node_tree
        background = tree.nodes["Background"]
        background.inputs["Color"].default_value = (*SKY_COLOUR, 1.0)
        place, parts, strength = (
            tree.nodes.new(f"ShaderNode{name}") for name in ("TexCoord", "SeparateXYZ", "MapRange")
        )
        tree.links.new(place.outputs["Generated"], parts.inputs[0])
        tree.links.new(parts.outputs["Z"], strength.inputs["Value"])
        for name, value in zip(("From Min", "From Max", "To Min", "To Max"), SKY_HEIGHTS + SKY_RADIANCE):
            strength.inputs[name].default_value = value
        tree.links.new(strength.outputs[0], background.inputs["Strength"])
    bpy.context.view_layer.update()
    return made


def render_images(scene: RealScene, most: int, source: str) -> None:
    """Render the layer, and of Cycles what is not there, up to `most` samples."""
    import bpy

    from ..cycles.settings import Choice, layers, picture

    version = f"Cycles {bpy.app.version_string.removesuffix(' LTS')}"
    with tempfile.TemporaryDirectory() as folder:
        made = stage(scene, Path(folder))
        for name, image, seconds in layers(Settings(threads=1)):
            keep(file_of(scene, name, Settings.depth_samples), image, seconds, source)
        for null in (False, True) if hasattr(made.cycles, "volume_biased") else (False,):
            way = f"{version}, null scattering" if null else version
            wanted = [(f"{way}, denoised", samples, True) for samples in LADDER] + [(way, NOISY, False)]
            for method, samples, denoised in sorted(wanted, key=lambda one: one[1]):
                path = file_of(scene, method, samples)
                if samples <= most and not path.exists():
                    choice = Choice(ALL_BOUNCES, samples, denoised, 0.0, null=null)
                    keep(path, *picture(made, Path(folder), choice), source)
                    print(path.relative_to(FOLDER), flush=True)


class Measured:
    """One scene's images against its reference.

    rungs: by method, by ascending samples. draws: of each image, by method and samples, its relative RMSE
    (1 + RESAMPLES,): as it is, then with the reference's tiles resampled, the same for all images of the scene.
    """

    def __init__(self, scene: RealScene):
        pair = halves(scene)
        mask = pair[..., 3].mean(axis=0) > MASK_ALPHA
        self.scene, (a, b) = scene, pair[..., :3] * mask[..., None]
        mean = (a + b) / 2
        counts = tile_sums(mask.astype(float))
        shown = counts > 0
        drawn = np.random.default_rng(0).integers(0, shown.sum(), size=(RESAMPLES, shown.sum()))

        def sums(values):
            tiles = tile_sums(values)[shown]
            return np.concatenate([[tiles.sum()], tiles[drawn].sum(axis=1)])

        count, brightness = sums(mask.astype(float)), sums(mean.mean(axis=-1))
        self.flip_noise = _flip(a, mean) if scene.rows <= FLIP_ROWS else None
        self.rungs, self.draws, self.sources = {}, {}, []
        for path in sorted((FOLDER / "images" / scene.name).glob("*.npz")):
            method, samples = path.stem.rsplit(", ", 1)
            with np.load(path) as data:
                image, seconds = data["image"] * mask[..., None], float(data["seconds"])
                self.sources.append(str(data["made_by"]))
            squares = sums(((image - a) * (image - b)).mean(axis=-1))
            errors = np.sqrt(np.maximum(squares / count, 0.0)) / (brightness / count)
            self.draws[method, int(samples)] = errors
            rmse = Estimate(errors[0], *np.percentile(errors[1:], [2.5, 97.5]))
            flip = None if self.flip_noise is None else _flip(image, mean)
            bias = relative_bias(image, a, b, mask)
            rung = Rung(method, int(samples), float("nan"), seconds, 0.0, 0.0, rmse, bias, flip)
            self.rungs.setdefault(method, []).append(rung)
        for rungs in self.rungs.values():
            rungs.sort(key=lambda rung: rung.samples)

    def ratios(self, method: str, of: str) -> tuple[np.ndarray, str]:
        """How many times as long as the layer a method takes to its error, (1 + RESAMPLES,), and how that is known."""
        layer = self.rungs[of][0]
        errors = self.draws[of, layer.samples]
        if method.endswith("denoised"):
            rungs = self.rungs[method]
            draws = np.stack([self.draws[method, rung.samples] for rung in rungs], axis=1)
            reached = [_on_ladder(rungs, row, error) for row, error in zip(draws, errors)]
            return np.array([one.value for one in reached]) / layer.cpu_seconds, reached[0].how
        # Noise alone; a sample's seconds are those of the denoised ladder, where more of them were rendered.
        [noisy] = self.rungs[method]
        ladder = self.rungs[f"{method}, denoised"]
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


FLIP_ROWS = 512


def _flip(image: np.ndarray, reference: np.ndarray) -> float | None:
    from mrpnn_addon.comparison.perceptual import flip

    return flip(image, reference)


def span(values: np.ndarray, how: str = "") -> str:
    """A ratio and its interval."""
    low, high = np.percentile(values[1:], [2.5, 97.5])
    sign = {AT_LEAST: "≥ ", AT_MOST: "≤ "}.get(how, "")
    upper = f"{high:.3g}" if np.isfinite(high) else "beyond telling"
    return f"{sign}{values[0]:.3g} ({low:.3g}–{upper})"


def section(measured: list[Measured]) -> str:
    """The tables: geometric means, then every scene."""
    methods = sorted({method for one in measured for method in one.rungs if method not in (FIRST, NEXT)})
    methods.sort(key=lambda method: method.endswith("denoised"))
    rows, means = [], []
    for method in methods:
        for of in (FIRST, NEXT):
            known = [
                one
                for one in measured
                if method in one.rungs and f"{method.removesuffix(', denoised')}, denoised" in one.rungs
            ]
            found = [one.ratios(method, of) for one in known]
            square = [ratios for one, (ratios, _) in zip(known, found) if one.scene.rows == 512]
            if square:
                with np.errstate(divide="ignore"):
                    mean = np.exp(np.mean(np.log(square), axis=0))
                means.append([method, of.rpartition(", ")[2], span(mean), f"{len(square)} of 5"])
            for one, (ratios, how) in zip(known, found):
                rows.append((one, method, of, span(ratios, how)))
    lines = []
    for one in measured:
        size = f"{one.scene.spec.size} × {one.scene.rows}"
        for method, rungs in sorted(one.rungs.items(), key=lambda item: (item[0] not in (FIRST, NEXT), item[0])):
            ratio = {of: text for other, name, of, text in rows if (other, name) == (one, method)}
            for rung in rungs:
                last = rung is rungs[-1]
                lines.append(
                    [
                        one.scene.name,
                        size,
                        method,
                        str(rung.samples),
                        f"{rung.rmse.value:.3f} ({rung.rmse.low:.3f}–{rung.rmse.high:.3f})",
                        f"{100 * rung.bias.value:+.1f} %",
                        f"{rung.cpu_seconds:.3g}",
                        _shown_flip(rung, one.flip_noise),
                        f"{ratio[FIRST]} / {ratio[NEXT]}" if last and ratio else "",
                    ]
                )
    head = ["scene", "pixels", "method", "samples", "error", "bias", "processor seconds", "FLIP",
            "times as long to the layer's error, first / next frame"]  # fmt: skip
    summary = table(["against", "frame of the layer", "geometric mean of times as long", "scenes of 512²"], means)
    return f"{summary}\n{table(head, lines)}".rstrip()


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
    write_page([Measured(scene) for scene in SCENES if (FOLDER / "images" / scene.name).is_dir() and traced(scene)])
    return 0


def write_page(measured: list[Measured]) -> None:
    """The section between its marks, and the CSV."""
    sources = sorted({source for one in measured for source in one.sources})
    replace_file(DOCS / "real-sizes.csv", csv_text(sources, COLUMNS, csv_rows(measured)))
    page = DOCS / "error-vs-time.md"
    replace_file(page, with_table(page.read_text(), "real sizes", section(measured), "\n".join(sources)))


if __name__ == "__main__":
    sys.exit(main())
