# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated time that the optimizations saved, from what the rest of the render took."""

from ..runtime.report import Report
from ..scene.settings import Settings
from .plan import Plan


def estimated_savings(report: Report, plan: Plan, settings: Settings) -> dict[str, float]:
    """Approximate wall-clock seconds saved by each of `plan.optimizations`.

    Leaves out those about which the report tells nothing, and savings below a hundredth of a second.
    """

    def count(name: str) -> int:
        return report.counts.get(name, 0)

    prediction, march, fields = (report.seconds.get(stage, 0.0) for stage in ("network", "march", "fields"))
    per_point = prediction / max(count("network points"), 1)
    jobs = count("network points wanted") / max(count("points"), 1)
    rendered = len(plan.channels)
    suns = max(len(plan.suns), 1)
    saved = {
        "empty_space": march * (count("steps") / max(count("steps evaluated"), 1) - 1.0),
        "equal_channels": (3 - rendered) * (march + fields + prediction) / max(rendered, 1),
        "needless_suns": count("suns left out") * (report.seconds.get("shadows", 0.0) + fields + prediction) / suns,
        "faint_rays": per_point * jobs * (settings.depth_samples * count("rays that meet density") - count("points")),
        "shared_pixels": per_point * (count("network points wanted") - count("network points")),
    }
    return {name: round(value, 2) for name, value in saved.items() if name in plan.optimizations and value >= 0.01}
