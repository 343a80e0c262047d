"""About how long what was left out would have taken, from what the rest took."""



def estimated_savings(report, plan, settings) -> dict[str, float]:
    """Seconds by the clock for each of `plan.leave_out` of which the report's counts and times tell; without those that
    saved less than a hundredth of a second.
    """
    count, seconds = report.counts.get, report.seconds.get
    prediction, march, fields = (seconds(stage, 0.0) for stage in ("network", "march", "fields"))
    a_point = prediction / max(count("network points", 0), 1)
    jobs = count("network points wanted", 0) / max(count("points", 0), 1)
    rendered = len(plan.channels)
    suns = max(len(plan.suns), 1)
    spared = {
        "empty_space": march * (count("steps", 0) / max(count("steps evaluated", 0), 1) - 1.0),
        "equal_channels": (3 - rendered) * (march + fields + prediction) / max(rendered, 1),
        "needless_suns": count("suns left out", 0) * (seconds("shadows", 0.0) + fields + prediction) / suns,
        "faint_rays": a_point * jobs * (settings.depth_samples * count("rays that meet density", 0) - count("points", 0)),
        "shared_pixels": a_point * (count("network points wanted", 0) - count("network points", 0)),
    }
    return {name: round(value, 2) for name, value in spared.items() if name in plan.leave_out and value >= 0.01}
