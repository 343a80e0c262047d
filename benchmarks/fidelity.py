"""How far the predicted image is from independent path-traced references.

    python -m benchmarks.fidelity --out build/fidelity [--depth-samples 128] [--model mrpnn]

Reads the views beside the project in ../shared/fidelity: two noisy halves each, so that the
error is measured without the references' own noise, and the published network's
figures. Writes fidelity.csv, the same as a table in fidelity.md, and a picture a view: ours,
reference, signed error.
"""

import argparse
import csv
import json
import pathlib

import numpy as np
from PIL import Image

from inference import Camera, Medium, Settings, Sun, Volume, render
from inference.error import paper_metric, relative_bias, relative_rmse

SHARED = pathlib.Path(__file__).resolve().parents[2] / "shared" / "fidelity"
# The references leave out some faint pixels; those count that show the medium.
MASK_ALPHA = 0.02


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


def cube_volume(density: np.ndarray, name: str) -> Volume:
    """A grid whose cells fill the cube [-1/2, 1/2]^3."""
    cells = density.shape[0]
    world_from_index = np.diag([1.0 / cells] * 3 + [1.0])
    world_from_index[:3, 3] = 0.5 / cells - 0.5
    return Volume(density, world_from_index, name)


def render_view(key: str, view, settings: Settings):
    """The layer of one reference view."""
    name = key.split("-")[0]
    with np.load(SHARED / "volumes" / f"{name}.npz") as data:
        volume = cube_volume(data["density"], name)
    height, width = view["ab"].shape[1:3]
    camera = Camera(look_at(view["cam"]), resolution=(width, height), fov=np.radians(float(view["fov"])))
    medium = Medium(float(view["sigma"]), view["albedo"], float(view["g"]))
    return render([(volume, medium)], [Sun(view["sun"], 1.0)], camera, settings)


def picture(rgb, a, b) -> Image.Image:
    """Ours, the reference, and the signed error (red too bright, blue too dark), side by side."""
    reference = 0.5 * (a + b)
    exposure = 0.7 / max(np.percentile(reference, 99), 1e-9)
    shown = [np.clip(image * exposure, 0.0, 1.0) ** (1 / 2.2) for image in (rgb, reference)]
    error = (rgb - reference).mean(axis=-1) * exposure
    red, blue = np.clip(error, 0, 1), np.clip(-error, 0, 1)
    signed = np.stack([1.0 - blue, 1.0 - red - blue, 1.0 - red], axis=-1)
    strip = np.concatenate([*shown, np.clip(signed, 0.0, 1.0)], axis=1)
    image = Image.fromarray((strip * 255.0 + 0.5).astype(np.uint8))
    return image.resize((image.width * 3, image.height * 3), Image.NEAREST)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--depth-samples", type=int, default=128)
    parser.add_argument("--model", default="mrpnn")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    published = json.loads((SHARED / "published_network.json").read_text())
    settings = Settings(depth_samples=arguments.depth_samples, model=arguments.model)
    rows = []
    print(f"{'view':34} {'rel. RMSE':>18} {'published':>9} {'bias':>7} {'published':>9} {'paper':>6} {'published':>9}")
    for key, theirs in published.items():
        view = np.load(SHARED / "views" / f"{key}.npz")
        layer = render_view(key, view, settings)
        a, b = view["ab"][0].astype(np.float64), view["ab"][1].astype(np.float64)
        mask = 0.5 * (a[..., 3] + b[..., 3]) > MASK_ALPHA
        a, b = a[..., :3], b[..., :3]
        # A grey view keeps its radiance in every channel.
        rmse = relative_rmse(layer.rgb, a, b, mask)
        bias = relative_bias(layer.rgb, a, b, mask)
        metric = paper_metric(layer.rgb * mask[..., None], a * mask[..., None], b * mask[..., None])
        rows.append([key, rmse.value, rmse.low, rmse.high, bias.value, metric, layer.report.seconds["total"]])
        interval = f"{rmse.value:.3f} ({rmse.low:.3f}-{rmse.high:.3f})"
        print(
            f"{key:34} {interval:>18} {theirs['rel_rmse']:9.3f} {bias.value:+7.3f} {theirs['rel_bias']:+9.3f} "
            f"{metric:6.2f} {theirs['paper']:9.2f}",
            flush=True,
        )
        picture(layer.rgb, a, b).save(arguments.out / f"{key}.png")
    mean = np.mean([row[1] for row in rows])
    theirs = list(published.values())
    print(
        f"{'mean':34} {mean:18.3f} {np.mean([t['rel_rmse'] for t in theirs]):9.3f} "
        f"{np.mean([row[4] for row in rows]):+7.3f} {np.mean([t['rel_bias'] for t in theirs]):+9.3f}"
    )
    with open(arguments.out / "fidelity.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["view", "rel_rmse", "rel_rmse_low", "rel_rmse_high", "rel_bias", "paper_metric", "seconds"])
        writer.writerows(rows)
    write_table(arguments.out / "fidelity.md", rows, published)


def write_table(path: pathlib.Path, rows, published):
    """The figures beside the published network's, as Markdown."""
    lines = ["| view | relative RMSE (95 %) | published | bias | published | paper's metric | published |"]
    lines.append("|---|---|---|---|---|---|---|")
    for (key, rmse, low, high, bias, metric, _), theirs in zip(rows, published.values()):
        lines.append(
            f"| {key} | {rmse:.3f} ({low:.3f}–{high:.3f}) | {theirs['rel_rmse']:.3f} | {100 * bias:+.1f} % | "
            f"{100 * theirs['rel_bias']:+.1f} % | {metric:.2f} | {theirs['paper']:.2f} |"
        )
    theirs = list(published.values())
    means = [np.mean([row[i] for row in rows]) for i in (1, 4, 5)]
    published_means = [np.mean([t[k] for t in theirs]) for k in ("rel_rmse", "rel_bias", "paper")]
    lines.append(
        f"| **mean** | {means[0]:.3f} | {published_means[0]:.3f} | {100 * means[1]:+.1f} % | "
        f"{100 * published_means[1]:+.1f} % | {means[2]:.2f} | {published_means[2]:.2f} |"
    )
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
