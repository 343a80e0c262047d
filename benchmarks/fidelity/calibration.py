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
import functools
import json
import pathlib
from dataclasses import asdict, dataclass

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot
from scipy import stats

from evaluation.error import relative_bias, relative_rmse
from inference import Settings
from inference.image import predicted_error
from inference.image.predicted_error import SHOWN_ALPHA

from ..support.data import ROOT
from ..support.pages import csv_text, replace, write_tables
from ..support.provenance import made_by, weights_checksum
from .drawn_views import (
    CALIBRATION_SEEDS,
    CALIBRATION_VIEWS,
    PARTS,
    SIZE,
    TEST_SEEDS,
    TEST_VIEWS,
    drawn_views,
    outside_views,
)
from .views import MASK_ALPHA, View, independent_views

PROGRAM = "benchmarks.fidelity.calibration"
#: A picture has so many times the reference's pixels along an edge.
FINER = 3
DEPTH_SAMPLES = 4
#: Stated probabilities of the reliability plot.
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
#: Noise of pixels that count, over their stated deviations, and of the squared errors of pictures that count, over the
#: expected ones: where there is more, the brightest paths may be missing from references.
QUIET, FAINT = 0.7, 0.5
#: Stated deviation of pixels that count, over the picture's mean.
LEAST_STATED = 0.02
#: Parameters that are tried: of the logarithm of errors over expected ones, and of biases over them.
MIDDLES, SPREADS = np.linspace(-1.0, 1.0, 81), np.geomspace(0.05, 2.0, 60)
RESAMPLES = 300
#: Ratios of deviations whose mixture the pixels' errors are fitted by; the shares are found.
RATIOS = np.geomspace(0.1, 6.0, 14)


@dataclass
class Measured:
    """One view.

    group: calibration, test or outside. network, sampling: root mean squares of the stated deviations over the mean,
    the former without the factor JOINED. error, bias: relative RMSE and bias that were found. mean: radiance of
    the reference.
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
    mean: float
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
            float(light.mean(axis=0)[shown].mean()),
            int(shown.sum()),
        )
        stated = [one[centre, centre][shown] for one in (deviation, layer.sampling_error)]
        pixels = np.stack([(image - light.mean(axis=0))[shown], *stated, noise])
        folder.mkdir(parents=True, exist_ok=True)
        with open(path.with_suffix(".partial"), "wb") as file:
            np.savez(file, pixels=pixels, found=json.dumps(asdict(found)))
        path.with_suffix(".partial").replace(path)
    with np.load(path) as data:
        found = Measured(**json.loads(str(data["found"])))
        # Relative to the mean, so that pictures can be compared.
        return found, data["pixels"] / found.mean


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


def quiet_pixels(pixels: list[np.ndarray], joined: float) -> np.ndarray:
    """(3, N), differences, stated deviations and the noise's, of pixels whose reference tells their error.

    Where next to nothing is stated there is next to no light, and references miss the paths that bring it.
    """
    difference, network, sampling, noise = np.concatenate(pixels, axis=1)
    stated = np.hypot(joined * network, sampling)
    return np.stack([difference, stated, noise])[:, (noise < QUIET * stated) & (stated > LEAST_STATED)]


class Pictures:
    """Errors and biases of V pictures over the expected errors, without the references' noise.

    Errors over expected ones are taken as log-normal, biases over them as normal around 0; `likelihood` (V, MIDDLES,
    SPREADS) and `bias_likelihood` (V, SPREADS) are logarithmic, of their parameters.
    """

    def __init__(self, pixels: list[np.ndarray], joined: float):
        squares, biases = [], []
        for difference, network, sampling, noise in pixels:
            expected, count = joined**2 * (network**2).sum() + (sampling**2).sum() + 1e-30, len(noise)
            # The noise's variance, which is subtracted, is itself estimated from few parts.
            spread = np.sqrt(2.0 * (1.0 + 1.0 / (PARTS - 1)) * (noise**4).sum()) / expected
            if not spread < FAINT:
                continue
            squares.append(((difference**2 - noise**2).sum() / expected, spread, 4.0 * (noise**2).max() / expected))
            scale = np.sqrt(expected * count)
            biases.append((difference.sum() / scale, np.sqrt((noise**2).sum()) / scale))
        self.square, self.spread, crossed = np.array(squares).reshape(-1, 3).T
        self.bias, self.bias_spread = np.array(biases).reshape(-1, 2).T
        nodes, weights = np.polynomial.hermite_e.hermegauss(24)
        ratio = np.exp(MIDDLES[:, None, None] + SPREADS[:, None] * nodes) ** 2
        variance = self.spread[:, None, None, None] ** 2 + crossed[:, None, None, None] * ratio + 1e-4
        density = np.exp(-0.5 * (self.square[:, None, None, None] - ratio) ** 2 / variance) / np.sqrt(variance)
        self.likelihood = np.log(np.maximum(density @ weights, 1e-100))
        variance = SPREADS**2 + self.bias_spread[:, None] ** 2
        self.bias_likelihood = -0.5 * (self.bias[:, None] ** 2 / variance + np.log(variance))

    def error_parameters(self, counts: np.ndarray | None = None) -> tuple[float, float]:
        """Middle and spread of the logarithm of errors over expected ones; counts: (V,), of a bootstrap."""
        counts = np.ones(len(self.square)) if counts is None else counts
        sums = np.tensordot(counts, self.likelihood, 1)
        middle, spread = np.unravel_index(sums.argmax(), sums.shape)
        return float(MIDDLES[middle]), float(SPREADS[spread])

    def bias_parameter(self, counts: np.ndarray | None = None) -> float:
        """Standard deviation of biases over expected errors."""
        counts = np.ones(len(self.square)) if counts is None else counts
        return float(SPREADS[(counts @ self.bias_likelihood).argmax()])

    def errors_within(self, ends, counts: np.ndarray | None = None) -> float:
        """Share of pictures whose error over the expected one lies between two ends."""
        middle, spread = self.error_parameters(counts)
        low, high = stats.norm.cdf((np.log(ends) - middle) / spread)
        return float(high - low)

    def biases_within(self, end: float, counts: np.ndarray | None = None) -> float:
        """Share of pictures whose bias over the expected error is below an end."""
        return float(2.0 * stats.norm.cdf(end / self.bias_parameter(counts)) - 1.0)


def normal_end(level: float) -> float:
    """Standard deviations within which a share of a normal distribution lies."""
    return float(stats.norm.ppf(0.5 + level / 2.0))


def fit(pixels: list[np.ndarray]) -> dict:
    """Constants of `predicted_error` by the calibration's views."""
    tries = np.geomspace(0.3, 2.0, 39)
    joined = min(tries, key=lambda value: abs(Pictures(pixels, value).error_parameters()[0]))
    pictures, shares = Pictures(pixels, joined), mixture_shares(quiet_pixels(pixels, joined))
    _, spread = pictures.error_parameters()
    return {
        "JOINED": joined,
        "HALF_OF_PIXELS": multiple_of(shares, 0.5),
        "MOST_OF_PIXELS": multiple_of(shares, 0.95),
        "HALF_OF_PICTURES": np.exp(normal_end(0.5) * spread * np.array([-1.0, 1.0])),
        "MOST_OF_PICTURES": np.exp(normal_end(0.95) * spread * np.array([-1.0, 1.0])),
        "BIAS": normal_end(0.95) * pictures.bias_parameter(),
    }


def coverage(pixels: list[np.ndarray]) -> list[tuple[str, float, float, str]]:
    """Rows of the table: what is stated, how often, how often it was found, and its 95 % interval or pixels."""
    pictures, random, rows = Pictures(pixels, predicted_error.JOINED), np.random.default_rng(0), []
    views = len(pictures.square)
    drawn = random.multinomial(views, np.full(views, 1.0 / views), RESAMPLES)
    ratio, bias = np.sqrt(np.maximum(pictures.square, 0.0)), np.abs(pictures.bias)
    half, most, end = predicted_error.HALF_OF_PICTURES, predicted_error.MOST_OF_PICTURES, predicted_error.BIAS
    for what, level, share_of, inside in (
        (
            "pictures' errors",
            0.5,
            functools.partial(pictures.errors_within, half),
            (ratio > half[0]) & (ratio < half[1]),
        ),
        (
            "pictures' errors",
            0.95,
            functools.partial(pictures.errors_within, most),
            (ratio > most[0]) & (ratio < most[1]),
        ),
        ("pictures' biases", 0.95, functools.partial(pictures.biases_within, end), bias < end),
    ):
        low, high = np.quantile([share_of(counts) for counts in drawn], [0.025, 0.975])
        plain = f"{low:.0%} to {high:.0%}; with the noise {inside.sum()} of {views} pictures"
        rows.append((what, level, share_of(None), plain))
    shown = quiet_pixels(pixels, predicted_error.JOINED)
    shares = mixture_shares(shown)
    for level, multiple in ((0.5, predicted_error.HALF_OF_PIXELS), (0.95, predicted_error.MOST_OF_PIXELS)):
        rows.append(("pixels' errors", level, within(shares, multiple), f"{shown.shape[1]} pixels"))
    return rows


def plot(path: pathlib.Path, calibration: list[np.ndarray], test: list[np.ndarray]) -> None:
    """The reliability plot: found against stated probabilities, and found against expected errors of pictures."""
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    joined = predicted_error.JOINED
    of_calibration, of_test = (mixture_shares(quiet_pixels(pixels, joined)) for pixels in (calibration, test))
    known, tested = Pictures(calibration, joined), Pictures(test, joined)
    _, spread = known.error_parameters()
    left.plot([0, 1], [0, 1], color="#999999", linewidth=1)
    found = [within(of_test, multiple_of(of_calibration, level)) for level in LEVELS]
    left.plot(LEVELS, found, "o-", color="#c0392b", label="pixels")
    ends = [np.exp(normal_end(level) * spread * np.array([-1.0, 1.0])) for level in LEVELS]
    left.plot(LEVELS, [tested.errors_within(pair) for pair in ends], "s-", color="#1f77b4", label="pictures")
    left.set(xlabel="stated probability", ylabel="share of the test's errors within", title="Reliability")
    left.legend()
    low, high = predicted_error.MOST_OF_PICTURES
    for pictures, colour, label in ((known, "#bbbbbb", "calibration"), (tested, "#1f77b4", "test")):
        order = pictures.spread
        square = np.stack([pictures.square - 2.0 * order, pictures.square, pictures.square + 2.0 * order])
        ratio = np.sqrt(np.maximum(square, 0.0))
        bars = [ratio[1] - ratio[0], ratio[2] - ratio[1]]
        right.errorbar(order, ratio[1], bars, fmt=".", color=colour, label=label, linewidth=0.6)
    right.axhspan(low, high, color="#1f77b4", alpha=0.15, label="stated 95 %")
    right.axhline(1.0, color="#999999", linewidth=1)
    right.set(xscale="log", ylim=(0.0, 4.0), title="Pictures")
    right.set(xlabel="noise of the squared error over the expected one", ylabel="error over the expected one")
    right.legend()
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def table(rows) -> str:
    lines = ["| stated of | stated | found on the test's views | of |", "|---|---|---|---|"]
    lines += [f"| {what} | {level:.0%} | {share:.1%} | {of} |" for what, level, share, of in rows]
    return "\n".join(lines)


def independent_table() -> str:
    """Expected and found errors of the independent references' views."""
    lines = ["| view | expected (95 %) | found (95 %) | bias within | bias found |", "|---|---|---|---|---|"]
    for view in independent_views():
        halves = view.halves()
        shown = halves[..., 3].mean(axis=0) > MASK_ALPHA
        a, b = halves[..., :3] * shown[..., None]
        layer = view.render(Settings(DEPTH_SAMPLES))
        image, stated = layer.rgb * shown[..., None], layer.report.expected_error
        found, bias = relative_rmse(image, a, b, shown), relative_bias(image, a, b, shown)
        lines.append(
            f"| {view.name} | {stated.error:.3f} ({stated.low:.3f}–{stated.high:.3f}) "
            f"| {found.value:.3f} ({found.low:.3f}–{found.high:.3f}) | {stated.bias:.1%} | {bias.value:+.1%} |"
        )
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
    for name, value in fit(found["calibration"][1]).items():
        print(f"{name} = {np.round(value, 3)}")
    source = f"{made_by(PROGRAM, options)} The network for the error: {weights_checksum('uncertainty/mrpnn')}."
    text = table(coverage(found["test"][1]))
    print(text)
    docs = ROOT / "docs" if arguments.docs else None
    rows = [asdict(one) for measured, _ in found.values() for one in measured]
    figures = csv_text([source], list(rows[0]), [row.values() for row in rows])
    replace((docs / "tables" if docs else arguments.out) / "calibration.csv", figures)
    plot((docs / "images" if docs else arguments.out) / "reliability.png", found["calibration"][1], found["test"][1])
    independent = independent_table()
    print(independent)
    if docs:
        write_tables("stated-error", text, [source])
        write_tables("stated-error-independent", independent, [source])
    else:
        (arguments.out / "calibration.md").write_text(f"{text}\n\n{independent}\n\n{source}\n")


if __name__ == "__main__":
    main()
