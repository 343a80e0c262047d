# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of error against run time from the figures of `benchmarks.error_vs_time`."""

import math

from evaluation.error import Estimate, error_text
from evaluation.error_vs_time import PathTracing, Rung, seconds_on_ladder

from ..fidelity.tables import table
from .cases import ENLARGED, EXTRAS

CYCLES, DENOISED = "cycles", "cycles denoised"
# The same by null scattering, which Cycles has beside ray marching from Blender 5.0 on.
NULL, NULL_DENOISED = "cycles null scattering", "cycles null scattering, denoised"
QUICKEST = "the quickest of these"
NOISY = "too noisy"


def equal(result, method: str, clock: str = "cpu_seconds"):
    """The equal-error and equal-time figures against one method, None where there are none."""
    return next((one for one in result["equal"] if (one["method"], one["clock"]) == (method, clock)), None)


def seconds_to_error(result, method: str, error: float = None, timed=None):
    """Cycles' processor seconds to the layer's error, or another; None where they cannot be told.

    timed: the figures of the same scene at another size, whose seconds count instead. Only without denoising: a path
    tracer's noise in a pixel does not depend on the size of the image, a filter's error does.
    """
    error = result["judged"]["rmse"]["value"] if error is None else error
    rungs = [
        Rung(**{**one, "rmse": Estimate(**one["rmse"]), "bias": Estimate(**one["bias"])})
        for one in result["rungs"]
        if one["method"] == method
    ]
    if not error or not rungs:
        return None
    if method in (DENOISED, NULL_DENOISED):
        return seconds_on_ladder(rungs, error, "cpu_seconds").value
    return _law(timed or result, method).seconds(_law(result, method).variance / error**2)


def times_as_long(result, method: str, per_frame: bool, error: float = None, timed=None):
    """`seconds_to_error` over the layer's."""
    needed, judged = seconds_to_error(result, method, error, timed), (timed or result)["judged"]
    return needed and needed / (judged["cpu_seconds"] - (judged["once_cpu"] if per_frame else 0.0))


def _law(result, method: str) -> PathTracing:
    return PathTracing(**result["path_tracing"][method]["cpu_seconds"])


def ways(result, denoised: bool) -> list:
    """The methods of Cycles that were measured: by ray marching, and by null scattering where it has that."""
    several = (DENOISED, NULL_DENOISED) if denoised else (CYCLES, NULL)
    return [method for method in several if rung(result, method)]


def cycles(result, method: str = CYCLES) -> str:
    """A method of Cycles with its version."""
    words = [f"Cycles {result['cycles'].removesuffix(' LTS')}"]
    words += ["null scattering"] if method in (NULL, NULL_DENOISED) else []
    return ", ".join(words + (["denoised"] if method in (DENOISED, NULL_DENOISED) else []))


def quickest(ratios: dict) -> dict:
    """Ratios and what they would be at the upper end of the error, (2,), by scene, of what is quickest in each scene.

    ratios: the same by method and scene; None where a ratio cannot be told.
    """
    found: dict = {}
    for pairs in ratios.values():
        for scene, pair in pairs.items():
            known = found.get(scene, (None, None))
            found[scene] = tuple(min(filter(None, both), default=None) for both in zip(known, pair))
    return found


def geometric_mean(values) -> float:
    values = list(values)
    return math.exp(sum(map(math.log, values)) / len(values))


def rung(result, method: str):
    """The method's first rung; for the layer the judged one."""
    return next((one for one in result["rungs"] if one["method"] == method), None)


def of_the_set(results) -> list:
    """Without those that show how costs grow."""
    return [result for result in results if not result["case"]["growth"]]


def counted(results) -> list:
    """Those that anyone can measure from the repository alone; no mean is over others."""
    return [result for result in results if result["case"]["volume"] not in EXTRAS]


def sources(results) -> list:
    """The sentences on what made the figures, each once."""
    return list(dict.fromkeys(result["made_by"] for result in results if "made_by" in result))


def csv_table(results):
    """Header, and a row for each image: the case, the method, its error, its time."""
    rows = []
    for result in results:
        for rung in result["rungs"]:
            row = {**result["case"], "version": result["cycles"]}
            row.update({name: value for name, value in rung.items() if not isinstance(value, dict)})
            for name in ("rmse", "bias"):
                row.update(
                    {
                        f"{name}{end}": rung[name][key]
                        for end, key in (("", "value"), ("_low", "low"), ("_high", "high"))
                    }
                )
            rows.append(row)
    return list(rows[0]), [
        [f"{value:.5g}" if isinstance(value, float) else value for value in row.values()] for row in rows
    ]


def tables(results) -> dict[str, str]:
    """Markdown tables by the names of their files: ratios, scenes, denoised images and how costs grow."""
    main = of_the_set(results)
    made = {"time-headline": headline(counted(main), results), "time-scenes": scenes(main, model(results))}
    return {
        **(made if main else {}),
        "time-denoised": filtered(results),
        "time-growth": growth(results),
    }


def model(results) -> str:
    """The network that was judged."""
    return results[0]["judged"]["method"]


def headline(main, results) -> str:
    """Geometric means over the scenes whose error the reference can tell from 0; by the intervals' ends, over all."""
    size, rows = main[0]["case"]["size"], []
    for pixels in (size, ENLARGED * size):
        timed = [(r, at_size(r, pixels, results)) for r in main]
        for denoised, wanted in ((False, 300), (True, 10)):
            for per_frame in () if denoised and pixels != size else (False, True):
                ratios: dict = {}
                for r, other in timed:
                    for method in ways(r, denoised) if other else ():
                        ratios.setdefault(cycles(r, method), {})[label(r)] = (
                            times_as_long(r, method, per_frame, None, other),
                            times_as_long(r, method, per_frame, r["judged"]["rmse"]["high"], other),
                        )
                if len(ratios) > 1:
                    ratios = {QUICKEST + ", denoised" * denoised: quickest(ratios), **ratios}
                for against, pairs in ratios.items():
                    by_error, by_high = ([one[i] for one in pairs.values() if one[i]] for i in (0, 1))
                    if by_error:
                        row = [f"{pixels}²", against, "frame" if per_frame else "first"]
                        rows.append([*row, *_means(by_error, by_high, wanted)])
    head = [
        "pixels",
        "against",
        "of the layer",
        "geometric mean",
        "least",
        "most",
        "by the intervals' upper ends",
        "scenes",
        "target reached",
    ]
    return (
        "How many times as long Cycles takes to reach the layer's error. *The quickest of these* takes in each scene "
        "the least of the ratios; Cycles 5 marches rays where the table does not say null scattering. Without "
        "denoising: by its measured noise, extrapolated with 1/√N. With denoising: extrapolated with 1/√N too, which "
        "is a lower bound. "
        f"At {ENLARGED * size}² the layer's seconds and Cycles' seconds per sample are those measured there; the "
        f"number of samples that Cycles needs is that at {size}², as if the layer's error were the same. Denoised "
        "Cycles has no such rows: the error that a filter leaves depends on the size (see below). Scenes of "
        f"volumes that the repository lacks ({', '.join(EXTRAS)}) count in no row. "
        "The references' noise leaves the errors uncertain: the mean by the intervals' upper ends, over all "
        "scenes, is the mean if each error were as large as its 95 % interval allows. A target counts as reached "
        "where that mean reaches it, and as missed where even the geometric mean falls short.\n\n" + table(head, rows)
    )


def _means(by_error: list, by_high: list, wanted: float) -> list:
    """Cells of the headline: ratios by the errors, by their upper ends, and whether they reach what is wanted."""
    mean, least = geometric_mean(by_error), geometric_mean(by_high)
    reached = "yes" if least >= wanted else "no" if mean < wanted else "not certain"
    figures = [f"{value:.3g}" for value in (mean, min(by_error), max(by_error), least)]
    return [*figures, f"{len(by_error)} of {len(by_high)}", f"{wanted}: {reached}"]


def filtered(results) -> str:
    """Denoised Cycles at two sizes."""
    rows = []
    for large in (r for r in results if r["case"]["growth"] == "filter"):
        small = at_size(large, results[0]["case"]["size"], results)
        for one, method in ((r, method) for r in (small, large) if r for method in ways(r, denoised=True)):
            judged = one["judged"]
            ladder = sorted((r for r in one["rungs"] if r["method"] == method), key=lambda r: r["samples"])
            times = [times_as_long(one, method, per_frame) for per_frame in (False, True)]
            rows.append(
                [
                    label(one),
                    f"{one['case']['size']}²",
                    _error(judged),
                    f"{judged['cpu_seconds']:.2g} / {judged['cpu_seconds'] - judged['once_cpu']:.2g}",
                    cycles(one, method),
                    ", ".join(f"{r['samples']}: {r['rmse']['value']:.3f}" for r in ladder),
                    "n/a" if None in times else f"{times[0]:.3g} / {times[1]:.3g} ×",
                ]
            )
    if not rows:
        return ""
    head = [
        "scene",
        "pixels",
        "layer: error",
        "seconds, first / frame",
        "denoised by",
        "error by samples per pixel",
        "to the layer's error: times first / frame",
    ]
    return (
        "The more pixels a feature has, the less of it a filter removes: of two "
        "scenes with little noise, errors were measured in larger images too.\n\n" + table(head, rows)
    )


def at_size(result, size: int, results):
    """The same scene's figures at another size by the same Cycles, None where there are none."""

    def scene(one, **other):
        return {**one["case"], "growth": "", "version": one["cycles"], **other}

    return next((one for one in results if scene(one) == scene(result, size=size)), None)


def scenes(main, network: str) -> str:
    """A row for each scene and way of Cycles through volumes; the quicker ones of a scene first."""
    rows = []
    by_scene = dict.fromkeys(label(result) for result in main)
    for result, method in (
        one
        for name in by_scene
        for one in sorted(
            ((r, method) for r in main if label(r) == name for method in ways(r, denoised=False)), key=_ratio_or_none
        )
    ):
        judged = result["judged"]
        row = [
            label(result),
            cycles(result, method),
            _error(judged),
            f"{judged['bias']['value']:+.1%}",
            f"{judged['cpu_seconds']:.2g} / {judged['cpu_seconds'] - judged['once_cpu']:.2g}",
        ]
        for one_method in (method, NULL_DENOISED if method == NULL else DENOISED):
            one = equal(result, one_method)
            error = judged["rmse"]["value"] or judged["rmse"]["high"]
            first, frame = (times_as_long(result, one_method, per_frame, error) for per_frame in (False, True))
            how = one and (one["needed"]["how"] if judged["rmse"]["value"] else "to the upper end")
            row.append(
                "n/a"
                if first is None
                else f"{first * judged['cpu_seconds']:.3g} s ({how}): {first:.3g} / {frame:.3g} ×"
            )
            row.append("n/a" if one is None else f"{one['error']['value']:.3f} ({one['error']['how']})")
        for baseline in ("single-scattering", "multi-octave"):
            found = rung(result, baseline)
            row.append(_error(found) if found else "n/a")
        row.append("good" if result["verdict"]["good"] else f"{NOISY}: {_more(result['verdict'])}")
        rows.append(row)
    head = [
        "scene",
        "against",
        f"{network}: error",
        "bias",
        "seconds, first / frame",
        "to this error: times first / frame",
        "in the first's time",
        "denoised to this error",
        "denoised in the first's time",
        "single-scattering",
        "multi-octave",
        "reference",
    ]
    return (
        "Where the reference cannot tell the error from 0 (*below*), the seconds are those to the upper end of its "
        "interval; n/a: that is 0 too. *Too noisy*: its noise moves the error by more than 10 %; "
        "how many times the samples a good one has.\n\n" + table(head, rows)
    )


def _ratio_or_none(one) -> float:
    """For sorting: how many times as long a (result, method) takes; the last where that cannot be told."""
    result, method = one
    judged = result["judged"]["rmse"]
    return times_as_long(result, method, False, judged["value"] or judged["high"]) or math.inf


def growth(results) -> str:
    """Costs where one thing changes: the layer's seconds, and Cycles' to an error of 0.1, by the first version."""
    base, version = results[0]["case"], cycles(results[0])
    results = [result for result in results if cycles(result) == version]
    rows = []
    for what, key in (
        ("pixels", "size"),
        ("voxels", "cells"),
        ("suns", "suns"),
        ("albedo", "albedo"),
        ("optical density", "optical_density"),
        ("G", "anisotropy"),
    ):
        same = [r for r in results if all(r["case"][k] == base[k] for k in base if k not in (key, "growth"))]
        if len({r["case"][key] for r in same}) < 2:
            continue
        for result in sorted(same, key=lambda r: r["case"][key]):
            law = result["path_tracing"][CYCLES]["cpu_seconds"]
            judged, value = result["judged"], result["case"][key]
            shown = f"{value}²" if key == "size" else f"{value}³" if key == "cells" else f"{value:g}"
            rows.append(
                [
                    what,
                    shown,
                    f"{judged['once_cpu']:.2g}",
                    f"{judged['cpu_seconds'] - judged['once_cpu']:.2g}",
                    f"{law['each']:.2g}",
                    f"{law['start'] + law['each'] * law['variance'] / 0.01:.3g}",
                ]
            )
    for one in (r for r in results[0]["rungs"] if r["method"] == results[0]["judged"]["method"]):
        rows.append(
            [
                "depth samples",
                str(one["samples"]),
                f"{one['once_cpu']:.2g}",
                f"{one['cpu_seconds'] - one['once_cpu']:.2g}",
                "",
                "",
            ]
        )
    head = [
        "grows",
        "value",
        "layer, once",
        "layer, frame",
        f"{version}, per sample per pixel",
        f"{version}, to an error of 0.1",
    ]
    return "Processor seconds, all else as in the first scene.\n\n" + table(head, rows)


def label(result) -> str:
    case = result["case"]
    return f"{case['volume']}, {case['light']}, G {case['anisotropy']:g}, density {case['optical_density']:g}"


def _error(found) -> str:
    rmse = found["rmse"]
    return error_text(rmse["value"], rmse["low"], rmse["high"])


def _more(verdict) -> str:
    return "beyond telling" if verdict["more"] is None else f"{verdict['more']:.1f} ×"
