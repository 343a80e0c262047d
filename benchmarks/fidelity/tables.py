# SPDX-License-Identifier: GPL-3.0-or-later
"""The measurements as Markdown, by kind of view: a summary, and the paper's Tables 1 and 2."""

from .real_volumes import FILES
from .views import ALBEDOS, ANISOTROPIES, GREY, LIGHTS, RETRACED, SIGMA_HAT, VOLUMES

#: Of RPNN, and of both tables' rows where nothing is varied.
USUAL_G = ANISOTROPIES[0]
#: Biases within this are fine.
BIAS_BOUND = 0.05


def table(head, rows) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def unique(values) -> list:
    return list(dict.fromkeys(values))


def _mean(values) -> float:
    values = list(values)
    return sum(values) / len(values)


def interval(m) -> str:
    return f"{m.rmse:.3f} ({m.rmse_low:.3f}–{m.rmse_high:.3f})"


def percent(share: float) -> str:
    return f"{100 * share:+.1f} %"


def boost(slower: float, faster: float) -> str:
    return f"{slower / faster:.3g} ×"


class Measured:
    """Measurements by view and system; what was not measured reads n/a."""

    def __init__(self, measurements):
        self.all = measurements
        self.systems = unique(m.system for m in measurements)
        self.by_key = {(m.view, m.system): m for m in measurements}

    def cell(self, view, system, write) -> str:
        one = self.by_key.get((view, system))
        return write(one) if one else "n/a"

    def cells(self, view, write) -> list:
        return [self.cell(view, system, write) for system in self.systems]

    def find(self, **facts):
        """The name of the view with these facts, None where there is none."""
        for m in self.all:
            if all(getattr(m, key) == value for key, value in facts.items()):
                return m.view
        return None


def summary(measured: Measured) -> str:
    """Each system over the views that all systems were measured on, so that means are comparable."""
    common = set.intersection(*({m.view for m in measured.all if m.system == s} for s in measured.systems))
    every = {m.view for m in measured.all}
    rows = []
    for system in measured.systems:
        for label, views in (("all it knows", every), ("common to all", common if common != every else ())):
            found = [m for m in measured.all if m.system == system and m.view in views]
            if found:
                worst = max(found, key=lambda m: abs(m.bias))
                rows.append(
                    [
                        system,
                        f"{label}, {len(found)}",
                        f"{_mean(m.rmse for m in found):.3f}",
                        percent(_mean(m.bias for m in found)),
                        f"{percent(worst.bias)} ({worst.view})",
                        f"{_mean(m.paper for m in found):.2f}",
                        f"{_mean(m.seconds for m in found):.1f}",
                    ]
                )
    head = ["system", "views", "relative RMSE", "bias", "largest bias", "paper's metric", "seconds per frame"]
    return table(head, rows)


def view_tables(measured: Measured, views: list[str], published: dict) -> str:
    """Errors and biases of each view and on the mean, beside the published network's where it was measured on them."""
    parts = []
    for title, key, write, number in (
        ("Relative RMSE (95 %)", "rmse", interval, "{:.3f}".format),
        ("Bias", "bias", lambda m: percent(m.bias), percent),
        ("Paper's metric", "paper", lambda m: f"{m.paper:.2f}", "{:.2f}".format),
    ):
        rows, means = [[view, *measured.cells(view, write)] for view in views], []
        for system in measured.systems:
            values = [getattr(measured.by_key[v, system], key) for v in views if (v, system) in measured.by_key]
            known = "" if len(values) == len(views) else f" ({len(values)} views)"
            means.append(number(_mean(values)) + known if values else "n/a")
        rows.append(["**mean**", *means])
        if published:
            others = [published[view][key] for view in views]
            for row, value in zip(rows, [*others, _mean(others)], strict=True):
                row.append(number(value))
        head = ["view", *measured.systems, *(["published"] if published else [])]
        parts.append(f"{title}\n\n" + table(head, rows))
    return "\n".join(parts)


def real_tables(measured: Measured) -> str:
    """Real volumes: relative RMSE and bias of each system by volume and density, and their means."""
    parts = []
    for system in measured.systems:
        mine = [m for m in measured.all if m.system == system]
        kinds = unique((m.light, m.anisotropy) for m in mine)
        rows = []
        for volume, sigma_hat in unique((m.volume, m.sigma_hat) for m in mine):
            found = {(m.light, m.anisotropy): m for m in mine if (m.volume, m.sigma_hat) == (volume, sigma_hat)}
            cells = [f"{found[k].rmse:.3f} {percent(found[k].bias)}" if k in found else "n/a" for k in kinds]
            rows.append([volume, f"{sigma_hat:g}", *cells])
        columns = [[m for m in mine if (m.light, m.anisotropy) == kind] for kind in kinds]
        means = (f"{_mean(m.rmse for m in column):.3f} {percent(_mean(m.bias for m in column))}" for column in columns)
        rows.append(["**mean**", "", *means])
        head = ["volume", "optical density", *(f"{light}, G = {g:g}" for light, g in kinds)]
        within = sum(abs(m.bias) <= BIAS_BOUND for m in mine)
        parts.append(
            f"{system}: {_mean(m.rmse for m in mine):.3f} on the mean, bias {percent(_mean(m.bias for m in mine))}, "
            f"within {100 * BIAS_BOUND:g} % on {within} of {len(mine)} views\n\n" + table(head, rows)
        )
    return "\n".join(parts)


def table1(measured: Measured) -> str:
    """Volumes x light at albedo 1: errors, then seconds and convergence boosts."""
    rows = [
        (m.volume, m.light, m.view)
        for m in measured.all
        if m.albedo == GREY and m.anisotropy == USUAL_G and m.sigma_hat == SIGMA_HAT
    ]
    rows = [
        (v, light, view)
        for v in unique(r[0] for r in rows)
        for light in LIGHTS
        for view in unique(r[2] for r in rows if r[:2] == (v, light))
    ]
    errors = [
        [v, light, *measured.cells(view, lambda m: f"{interval(m)} · {m.paper:.2f} · {percent(m.bias)}")]
        for v, light, view in rows
    ]
    means, costs = [], []
    for system in measured.systems:
        own = [measured.by_key[view, system] for _, _, view in rows if (view, system) in measured.by_key]
        figures = f"{_mean(m.rmse for m in own):.3f} · {_mean(m.paper for m in own):.2f}" if own else "n/a"
        means.append(f"{figures} · {percent(_mean(m.bias for m in own))}" if own else figures)
    errors.append(["**mean**", "", *means])
    for v, light, view in rows:
        rpnn = measured.by_key.get((view, "rpnn"))
        costs.append(
            [
                v,
                light,
                *measured.cells(
                    view,
                    lambda m: " · ".join(
                        [
                            f"{m.seconds:.2g} s",
                            boost(rpnn.seconds, m.seconds) if rpnn else "n/a",
                            boost(m.reference_seconds, m.seconds),
                        ]
                    ),
                ),
            ]
        )
    head = ["volume", "light", *measured.systems]
    return (
        "Error: relative RMSE (95 %) · the paper's metric · bias\n\n"
        + table(head, errors)
        + "\nSeconds per frame · convergence boost against RPNN · against the path tracer\n\n"
        + table(head, costs)
    )


def table2(measured: Measured) -> str:
    """Albedo and anisotropy varied: relative RMSE and the paper's metric, by light."""
    rows = []
    settings = [("ς = " + ", ".join(f"{value:g}" for value in albedo), albedo, USUAL_G) for albedo in ALBEDOS]
    settings += [(f"G = {g:g}", GREY, g) for g in ANISOTROPIES]
    for volume in unique(m.volume for m in measured.all):
        lines = []
        for label, albedo, g in settings:
            views = {
                light: measured.find(volume=volume, light=light, albedo=albedo, anisotropy=g, sigma_hat=SIGMA_HAT)
                for light in LIGHTS
            }
            if any(views.values()):
                cells = [
                    cell
                    for light in LIGHTS
                    for cell in measured.cells(views[light], lambda m: f"{m.rmse:.3f} · {m.paper:.2f}")
                ]
                lines.append([volume, label, *cells])
        # Where only the usual values were measured Table 1 has said it all.
        if len(lines) > 2:
            rows += lines
    head = ["volume", "parameter", *(f"{light}: {system}" for light in LIGHTS for system in measured.systems)]
    return table(head, rows) if rows else ""


def _views(measurement) -> str:
    """Which of the program's views it is of."""
    if measurement.volume in FILES:
        return "real"
    if measurement.view.endswith(RETRACED):
        return "retraced"
    return "procedural" if measurement.volume in VOLUMES else "independent"


def sections(measurements, published: dict) -> dict[str, str]:
    """Tables by the views that they are of, in Markdown; published: {view: {rmse, bias, paper}}."""
    found = {}
    for views in unique(_views(m) for m in measurements):
        measured = Measured([m for m in measurements if _views(m) == views])
        parts = [real_tables(measured) if views == "real" else summary(measured)]
        if views in ("independent", "retraced"):
            names = unique(m.view for m in measured.all)
            parts.append(view_tables(measured, names, published if views == "independent" else {}))
        if views in ("independent", "procedural"):
            parts.append(f"Volumes and lights, G = {USUAL_G:g}, albedo 1.\n\n{table1(measured)}")
            second = table2(measured)
            if second:
                parts.append(f"Albedo and anisotropy varied: relative RMSE · the paper's metric.\n\n{second}")
        found[views] = "\n".join(parts)
    return found


def document(measurements, published: dict, source: str) -> str:
    """All tables as one Markdown text; source: what made the figures."""
    parts = [
        "# Fidelity\n",
        f"{source}\n",
        "Relative RMSE by split references with bootstrap 95 % intervals; the paper's "
        "metric is RMSE × 100 of tone-mapped luma. 0: less than the references can resolve. n/a: the system does not "
        "know that albedo or anisotropy, or was not measured. The error of `reference`, the path tracer at the "
        "depth samples, is its noise. The boost against RPNN is the ratio of seconds per frame at equal samples, as in "
        "the paper; that against the path tracer is the time in which its noise would be as large as the system's "
        "whole error, over the system's seconds.\n",
    ]
    for views, text in sections(measurements, published).items():
        parts += [f"## Views: {views}\n", text]
    return "\n".join(parts)
