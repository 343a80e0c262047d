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
#: Noise of the squared error, over the expected squared error, of views that count.
TOLD = 0.25
#: Ratios of deviations whose mixture the pixels' errors are fitted by; the shares are found.
RATIOS = np.geomspace(0.1, 6.0, 14)


@dataclass
class Measured:
    """One view.

    group: calibration, test or outside. network, sampling: root mean squares of the stated deviations over the mean,
    the former without the factor JOINED. error, bias: relative RMSE and bias that were found. noise: standard deviation
    of the squared error that the reference's noise causes.
    """

    group: str
    view: str
    sigma_hat: float
    anisotropy: float
    albedo: float
    network: float
    sampling: float
    error: float
    bias: float
    noise: float
    pixels: int

    def expected(self, joined: float) -> float:
        """The relative RMSE that is stated; joined: the factor of the network's part."""
        return float(np.hypot(joined * self.network, self.sampling))


def measure(group: str, view: View, folder: pathlib.Path) -> tuple[Measured, np.ndarray]:
    """A view's figures, and its pixels (4, N).

    These are differences to the reference, the stated deviations of network (without JOINED) and depth sampling, and
    the deviation of the reference's noise.
    """
    path = folder / f"{group}-{view.name}-{weights_checksum('mrpnn')}-{weights_checksum('uncertainty/mrpnn')}.npz"
    if not path.exists():
        parts = view.halves()
        layer = view.render(Settings(DEPTH_SAMPLES, threads=1), FINER * SIZE)
        centre = slice(FINER // 2, None, FINER)
        image = layer.rgb[centre, centre].mean(axis=2, dtype=np.float64)
        light, alpha = parts[..., :3].mean(axis=3), parts[..., 3].mean(axis=0)
        shown = alpha > SHOWN_ALPHA
        a, b = light[::2].mean(axis=0), light[1::2].mean(axis=0)
        whole = layer.alpha > SHOWN_ALPHA
        deviation = np.sqrt(np.maximum(layer.uncertainty**2 - layer.sampling_error**2, 0.0)) / predicted_error.JOINED
        mean = layer.rgb.mean(axis=2)[whole].mean()
        network, sampling = (np.sqrt((one[whole] ** 2).mean()) / mean for one in (deviation, layer.sampling_error))
        noise = light.std(axis=0, ddof=1)[shown] / np.sqrt(len(light))
        found = Measured(
            group,
            view.name,
            view.spec.sigma_hat,
            view.spec.anisotropy,
            view.spec.albedo[0],
            float(network),
            float(sampling),
            relative_rmse(image * shown, a * shown, b * shown, shown).value,
            relative_bias(image * shown, a * shown, b * shown, shown).value,
            # Of a product of two halves, each of twice the variance of their mean.
            float(2.0 * np.sqrt((noise**4).sum()) / shown.sum() / light.mean(axis=0)[shown].mean() ** 2),
            int(shown.sum()),
        )
        stated = [one[centre, centre][shown] for one in (deviation, layer.sampling_error)]
        pixels = np.stack([(image - light.mean(axis=0))[shown], *stated, noise])
        folder.mkdir(parents=True, exist_ok=True)
        with open(path.with_suffix(".partial"), "wb") as file:
            np.savez(file, pixels=pixels, found=json.dumps(asdict(found)))
        path.with_suffix(".partial").replace(path)
    with np.load(path) as data:
        return Measured(**json.loads(str(data["found"]))), data["pixels"]


def mixture_shares(pixels: np.ndarray, rounds: int = 400) -> np.ndarray:
    """Shares of RATIOS in the distribution of errors over stated deviations, by maximum likelihood.

    pixels: (3, N), differences, stated deviations and the noise's, which is taken as normal.
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


def joined_pixels(pixels: list[np.ndarray], joined: float) -> np.ndarray:
    """(3, N), differences, stated deviations and the noise's, of the pixels of views in which any is stated."""
    difference, network, sampling, noise = np.concatenate(pixels, axis=1)
    stated = np.hypot(joined * network, sampling)
    return np.stack([difference, stated, noise])[:, stated > 0.0]


def told(measured: list[Measured], joined: float) -> list[Measured]:
    """Views in which an error is expected that their references can tell from noise."""
    return [one for one in measured if one.network > 0.0 and one.noise < TOLD * one.expected(joined) ** 2]


def ratios(measured: list[Measured], joined: float) -> np.ndarray:
    """Errors over expected ones."""
    return np.array([one.error / one.expected(joined) for one in told(measured, joined)])


def biases(measured: list[Measured], joined: float) -> np.ndarray:
    """Absolute biases over expected errors."""
    return np.array([abs(one.bias) / one.expected(joined) for one in told(measured, joined)])


def share_between(values: np.ndarray, ends) -> float:
    return float(np.mean((values >= ends[0]) & (values <= ends[1])))


def fit(measured: list[Measured], pixels: list[np.ndarray]) -> dict:
    """Constants of `predicted_error` by the calibration's views."""
    tries = np.geomspace(0.1, 3.0, 300)
    middle = [abs(np.log(np.median(ratios(measured, joined)))) for joined in tries]
    joined = float(tries[np.argmin(middle)])
    shares = mixture_shares(joined_pixels(pixels, joined))
    return {
        "JOINED": joined,
        "HALF_OF_PIXELS": multiple_of(shares, 0.5),
        "MOST_OF_PIXELS": multiple_of(shares, 0.95),
        "HALF_OF_PICTURES": np.quantile(ratios(measured, joined), [0.25, 0.75]),
        "MOST_OF_PICTURES": np.quantile(ratios(measured, joined), [0.025, 0.975]),
        "BIAS": np.quantile(biases(measured, joined), 0.95),
    }


def binomial_interval(inside: int, count: int) -> tuple[float, float]:
    """95 % interval (Clopper and Pearson) of a share."""
    low = stats.beta.ppf(0.025, inside, count - inside + 1) if inside else 0.0
    high = stats.beta.ppf(0.975, inside + 1, count - inside) if inside < count else 1.0
    return float(low), float(high)


def coverage(measured: list[Measured], pixels: list[np.ndarray]) -> list[tuple[str, float, float, str]]:
    """Rows of the table: what is stated, how often, how often it was found, and its 95 % interval or pixels."""
    joined = predicted_error.JOINED
    found, biased = ratios(measured, joined), biases(measured, joined)
    counted = (
        ("pictures' errors", 0.5, share_between(found, predicted_error.HALF_OF_PICTURES)),
        ("pictures' errors", 0.95, share_between(found, predicted_error.MOST_OF_PICTURES)),
        ("pictures' biases", 0.95, share_between(biased, (0.0, predicted_error.BIAS))),
    )
    rows = []
    for what, level, share in counted:
        low, high = binomial_interval(round(share * len(found)), len(found))
        rows.append((what, level, share, f"{low:.0%} to {high:.0%}, {len(found)} pictures"))
    shown = joined_pixels(pixels, predicted_error.JOINED)
    shares = mixture_shares(shown)
    for level, multiple in ((0.5, predicted_error.HALF_OF_PIXELS), (0.95, predicted_error.MOST_OF_PIXELS)):
        rows.append(("pixels' errors", level, within(shares, multiple), f"{shown.shape[1]} pixels"))
    return rows


def plot(path: pathlib.Path, calibration, test) -> None:
    """The reliability plot: found against stated probabilities, and found against expected errors of pictures."""
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    joined = predicted_error.JOINED
    of_calibration, of_test = (mixture_shares(joined_pixels(pixels, joined)) for _, pixels in (calibration, test))
    found = [within(of_test, multiple_of(of_calibration, level)) for level in LEVELS]
    left.plot([0, 1], [0, 1], color="#999999", linewidth=1)
    left.plot(LEVELS, found, "o-", color="#c0392b", label="pixels")
    known, tested = (ratios(measured, joined) for measured, _ in (calibration, test))
    ends = [np.quantile(known, [0.5 - level / 2, 0.5 + level / 2]) for level in LEVELS]
    left.plot(LEVELS, [share_between(tested, pair) for pair in ends], "s-", color="#1f77b4", label="pictures")
    left.set(xlabel="stated probability", ylabel="share of the test's errors within", title="Reliability")
    left.legend()
    low, high = predicted_error.MOST_OF_PICTURES
    line = np.geomspace(0.002, 0.7, 50)
    right.fill_between(line, line * low, line * high, color="#1f77b4", alpha=0.15, label="stated 95 %")
    right.plot(line, line, color="#999999", linewidth=1)
    for (measured, _), colour, label in ((calibration, "#bbbbbb", "calibration"), (test, "#1f77b4", "test")):
        one = told(measured, joined)
        stated = [view.expected(joined) for view in one]
        right.plot(stated, [max(view.error, 2e-3) for view in one], ".", color=colour, label=label)
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
            expected = measured.expected(predicted_error.JOINED)
            print(f"{group} {view.name}: expected {expected:.3f}, found {measured.error:.3f}", flush=True)
            found[group][0].append(measured)
            found[group][1].append(pixels)
    for name, value in fit(*found["calibration"]).items():
        print(f"{name} = {np.round(value, 3)}")
    source = made_by(PROGRAM, options, ["mrpnn", "uncertainty/mrpnn"])
    text = table(coverage(*found["test"]))
    print(text)
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
