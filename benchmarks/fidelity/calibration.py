# SPDX-License-Identifier: GPL-3.0-or-later
"""How often errors lie within the intervals that pictures state, on views drawn from the whole trained range.

    python -m benchmarks.fidelity.calibration --out build/calibration [--views 110] [--docs]

Traces views on the calibration's seeds, views on the test's seeds and views outside the trained range, by the project's
path tracer (build/references), and renders them at three times the references' size, of whose pixels each third has a
reference. Prints the constants of `inference/image/predicted_error.py` that fit the calibration's views, and writes
calibration.csv (a row for each view), calibration.md (coverage on the test's views) and reliability.png; --docs writes
them into docs. A run that is stopped continues where it was.
"""

import argparse
import json
import pathlib
from dataclasses import asdict, dataclass

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot
from scipy import stats

from inference import Settings
from inference.evaluation.error import relative_bias, relative_rmse
from inference.image import predicted_error
from inference.image.predicted_error import SHOWN_ALPHA

from ..support.data import ROOT
from ..support.pages import csv_text, replace, with_table
from ..support.provenance import made_by, weights_checksum
from .drawn_views import (
    CALIBRATION_SEEDS,
    CALIBRATION_VIEWS,
    SIZE,
    TEST_SEEDS,
    TEST_VIEWS,
    drawn_views,
    outside_views,
)
from .views import View

PROGRAM = "benchmarks.fidelity.calibration"
#: A picture has so many times the reference's pixels along an edge.
FINER = 3
DEPTH_SAMPLES = 4
#: Stated probabilities of the reliability plot.
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
#: Ratios of deviations whose mixture the pixels' errors are fitted by; the shares are found.
RATIOS = np.geomspace(0.1, 6.0, 14)


@dataclass
class Measured:
    """One view. expected, error: relative RMSE that was stated and found; bias: found, over the mean.

    group: calibration, test or outside.
    """

    group: str
    view: str
    sigma_hat: float
    anisotropy: float
    albedo: float
    expected: float
    error: float
    bias: float
    pixels: int


def measure(group: str, view: View, folder: pathlib.Path) -> tuple[Measured, np.ndarray]:
    """A view's figures, and its pixels (3, N): difference to the reference, the stated deviation, the noise's."""
    path = folder / f"{group}-{view.name}-{weights_checksum('mrpnn')}-{weights_checksum('uncertainty/mrpnn')}.npz"
    if not path.exists():
        parts = view.halves()
        layer = view.render(Settings(DEPTH_SAMPLES, threads=1), FINER * SIZE)
        centre = slice(FINER // 2, None, FINER)
        image = layer.rgb[centre, centre].mean(axis=2, dtype=np.float64)
        light, alpha = parts[..., :3].mean(axis=3), parts[..., 3].mean(axis=0)
        shown = alpha > SHOWN_ALPHA
        a, b = light[::2].mean(axis=0), light[1::2].mean(axis=0)
        expected = layer.report.expected_error
        # Neighbours share their noise's deviation, of which a pixel's own parts tell little.
        noise = light.std(axis=0, ddof=1)[shown] / np.sqrt(len(light))
        found = Measured(
            group,
            view.name,
            view.spec.sigma_hat,
            view.spec.anisotropy,
            view.spec.albedo[0],
            expected.error if expected else 0.0,
            relative_rmse(image * shown, a * shown, b * shown, shown).value,
            relative_bias(image * shown, a * shown, b * shown, shown).value,
            int(shown.sum()),
        )
        pixels = np.stack([(image - light.mean(axis=0))[shown], layer.uncertainty[centre, centre][shown], noise])
        folder.mkdir(parents=True, exist_ok=True)
        with open(path.with_suffix(".partial"), "wb") as file:
            np.savez(file, pixels=pixels, found=json.dumps(asdict(found)))
        path.with_suffix(".partial").replace(path)
    with np.load(path) as data:
        return Measured(**json.loads(str(data["found"]))), data["pixels"]


def mixture_shares(pixels: np.ndarray, rounds: int = 400) -> np.ndarray:
    """Shares of RATIOS in the distribution of errors over stated deviations, by maximum likelihood.

    pixels: (3, N), of `measure`. The noise is normal, of a deviation known in each pixel.
    """
    difference, stated, noise = pixels
    variance = (RATIOS[:, None] * stated) ** 2 + noise**2
    likelihood = np.exp(-0.5 * difference**2 / variance) / np.sqrt(variance)
    shares = np.full(len(RATIOS), 1.0 / len(RATIOS))
    for _ in range(rounds):
        weights = shares[:, None] * likelihood
        shares = (weights / np.maximum(weights.sum(axis=0), 1e-300)).mean(axis=1)
    return shares / shares.sum()


def within(shares: np.ndarray, multiple: float) -> float:
    """Share of errors below so many stated deviations."""
    return float(shares @ (2.0 * stats.norm.cdf(multiple / RATIOS) - 1.0))


def multiple_of(shares: np.ndarray, level: float) -> float:
    """So many stated deviations hold a share of the errors."""
    tries = np.geomspace(0.01, 30.0, 2000)
    return float(np.interp(level, [within(shares, value) for value in tries], tries))


def told(measured: list[Measured]) -> list[Measured]:
    """Those whose error is predicted and told from 0 by the reference."""
    return [one for one in measured if one.expected > 0.0]


def fit(measured: list[Measured], pixels: list[np.ndarray]) -> dict:
    """Constants of `predicted_error` by the calibration's views."""
    ratios = np.array([one.error / one.expected for one in told(measured)])
    typical = float(np.exp(np.log(np.maximum(ratios, 0.05)).mean()))
    shares = mixture_shares(np.concatenate(pixels, axis=1) * [[1.0], [typical], [1.0]])
    return {
        "JOINED": predicted_error.JOINED * typical,
        "HALF_OF_PIXELS": multiple_of(shares, 0.5),
        "MOST_OF_PIXELS": multiple_of(shares, 0.95),
        "HALF_OF_PICTURES": np.quantile(ratios, [0.25, 0.75]) / typical,
        "MOST_OF_PICTURES": np.quantile(ratios, [0.025, 0.975]) / typical,
        "BIAS": np.quantile([abs(one.bias) / one.expected for one in told(measured)], 0.95) / typical,
    }


def binomial_interval(inside: int, count: int) -> tuple[float, float]:
    """95 % interval (Clopper and Pearson) of a share."""
    low = stats.beta.ppf(0.025, inside, count - inside + 1) if inside else 0.0
    high = stats.beta.ppf(0.975, inside + 1, count - inside) if inside < count else 1.0
    return float(low), float(high)


def coverage(measured: list[Measured], pixels: list[np.ndarray]) -> list[tuple[str, float, float, str]]:
    """Rows of the table: what is stated, how often, how often it was found, and its 95 % interval or pixels."""
    ratios, count = np.array([one.error / one.expected for one in told(measured)]), len(told(measured))
    rows = []
    for level, (low, high) in ((0.5, predicted_error.HALF_OF_PICTURES), (0.95, predicted_error.MOST_OF_PICTURES)):
        inside = int(((ratios >= low) & (ratios <= high)).sum())
        ends = binomial_interval(inside, count)
        rows.append(("pictures' errors", level, inside / count, f"{ends[0]:.0%} to {ends[1]:.0%} of {count} pictures"))
    inside = sum(abs(one.bias) <= predicted_error.BIAS * one.expected for one in told(measured))
    ends = binomial_interval(inside, count)
    rows.append(("pictures' biases", 0.95, inside / count, f"{ends[0]:.0%} to {ends[1]:.0%} of {count} pictures"))
    joined = np.concatenate(pixels, axis=1)
    shares = mixture_shares(joined)
    for level, multiple in ((0.5, predicted_error.HALF_OF_PIXELS), (0.95, predicted_error.MOST_OF_PIXELS)):
        rows.append(("pixels' errors", level, within(shares, multiple), f"{joined.shape[1]} pixels"))
    return rows


def plot(path: pathlib.Path, calibration, test) -> None:
    """The reliability plot: found against stated probabilities, and found against expected errors of pictures."""
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    of_calibration, of_test = (mixture_shares(np.concatenate(pixels, axis=1)) for _, pixels in (calibration, test))
    found = [within(of_test, multiple_of(of_calibration, level)) for level in LEVELS]
    left.plot([0, 1], [0, 1], color="#999999", linewidth=1)
    left.plot(LEVELS, found, "o-", color="#c0392b", label="pixels")
    known = np.array([one.error / one.expected for one in told(calibration[0])])
    ratios = np.array([one.error / one.expected for one in told(test[0])])
    ends = [np.quantile(known, [0.5 - level / 2, 0.5 + level / 2]) for level in LEVELS]
    left.plot(
        LEVELS, [np.mean((ratios >= a) & (ratios <= b)) for a, b in ends], "s-", color="#1f77b4", label="pictures"
    )
    left.set(xlabel="stated probability", ylabel="share of the test's errors within", title="Reliability")
    left.legend()
    low, high = predicted_error.MOST_OF_PICTURES
    line = np.geomspace(0.002, 0.5, 50)
    right.fill_between(line, line * low, line * high, color="#1f77b4", alpha=0.15, label="stated 95 %")
    right.plot(line, line, color="#999999", linewidth=1)
    for views, colour, label in ((calibration[0], "#bbbbbb", "calibration"), (test[0], "#1f77b4", "test")):
        one = told(views)
        right.plot([v.expected for v in one], [max(v.error, 2e-3) for v in one], ".", color=colour, label=label)
    right.set(xscale="log", yscale="log", xlabel="expected error", ylabel="error found", title="Pictures")
    right.legend()
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def table(rows) -> str:
    lines = ["| stated of | stated | found on the test's views | of |", "|---|---|---|---|"]
    lines += [f"| {what} | {level:.0%} | {share:.1%} | {of} |" for what, level, share, of in rows]
    return "\n".join(lines)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("build/calibration"))
    parser.add_argument("--references", type=pathlib.Path, default=pathlib.Path("build/references"))
    parser.add_argument("--calibration-views", type=int, default=CALIBRATION_VIEWS)
    parser.add_argument("--views", type=int, default=TEST_VIEWS)
    parser.add_argument("--docs", action="store_true", help="write the table, the plot and the figures into docs")
    arguments = parser.parse_args(options)
    groups = {
        "calibration": drawn_views(CALIBRATION_SEEDS, arguments.calibration_views, arguments.references),
        "test": drawn_views(TEST_SEEDS, arguments.views, arguments.references),
        "outside": outside_views(arguments.references),
    }
    found = {}
    for group, views in groups.items():
        found[group] = [], []
        for view in views:
            measured, pixels = measure(group, view, arguments.out)
            print(f"{group} {view.name}: expected {measured.expected:.3f}, found {measured.error:.3f}", flush=True)
            found[group][0].append(measured)
            found[group][1].append(pixels)
    for name, value in fit(*found["calibration"]).items():
        print(f"{name} = {np.round(value, 3)}")
    source = made_by(PROGRAM, options, ["mrpnn", "uncertainty/mrpnn"])
    text = table(coverage(*found["test"]))
    print(text)
    outside = told(found["outside"][0])
    for one in outside:
        print(f"{one.view}: expected {one.expected:.3f}, found {one.error:.3f}")
    docs = ROOT / "docs" if arguments.docs else None
    rows = [asdict(one) for measured, _ in found.values() for one in measured]
    figures = csv_text([source], list(rows[0]), [row.values() for row in rows])
    replace((docs or arguments.out) / "calibration.csv", figures)
    plot((docs / "images" if docs else arguments.out) / "reliability.png", found["calibration"], found["test"])
    if docs:
        page = docs / "fidelity.md"
        replace(page, with_table(page.read_text(), "calibration", text, source))
    else:
        (arguments.out / "calibration.md").write_text(f"{text}\n\n{source}\n")


if __name__ == "__main__":
    main()
