# SPDX-License-Identifier: GPL-3.0-or-later
"""What the documentation states is so: constants, paths, commands, links and checksums."""

import importlib
import re

import pytest

from tests.support.paths import ROOT

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
# Folders that a clone does not have: what is built, data to train on, runs.
MADE = ("build", "data", "runs", ".venv")

# Page, sentence with numbers, module, and of each number its value there.
FACTS = [
    (
        "docs/understand/method-details.md",
        r"until the variance of direction reaches ([\d.]+) square",
        "inference.plan.joined_lamps",
        ("VARIANCE",),
    ),
    (
        "docs/understand/optimizations.md",
        r"until the variance of direction reaches ([\d.]+) square",
        "inference.plan.joined_lamps",
        ("VARIANCE",),
    ),
    (
        "docs/understand/method.md",
        r"κ is ([\d.]+), and ε is ([\d.]+) pixels",
        "inference.blur.sharpness",
        ("JOINED", "SHARP"),
    ),
    (
        "docs/understand/weights.md",
        r"Held-back seeds of evened volumes end at 1 (600) (999), those of solids at 1 (500) (999)",
        "training.procedural.volumes",
        (
            "max(HELD_BACK_SATURATED) // 1000 - 1000",
            "max(HELD_BACK_SATURATED) % 1000",
            "max(HELD_BACK_SOLIDS) // 1000 - 1000",
            "max(HELD_BACK_SOLIDS) % 1000",
        ),
    ),
    (
        "docs/understand/method-details.md",
        r"optically thicker than (\S+) is cut into 2, 4 or (\d+), up to (\d+) times\. .{0,40} for each (\d+)",
        "inference.marching.ray_steps",
        ("STEP_THICKNESS", "MOST_PARTS", "LEVELS", "STEP_GROWTH"),
    ),
    (
        "docs/understand/method-details.md",
        r"whose voxels are optically thinner than ([\d.]+),",
        "inference.image.lamp_pass",
        ("THICKEST_VOXEL",),
    ),
    (
        "docs/understand/method-details.md",
        r"from ([\d.]+)\s+times the lamp's reach",
        "inference.marching.mean_lamp_depth",
        ("APART",),
    ),
    (
        "docs/understand/method-details.md",
        r"phase function errs by more than (\d+) %",
        "inference.marching.lamp_in_media",
        ("100 * SMOOTH_ERROR",),
    ),
    (
        "docs/understand/method-details.md",
        r"could be thicker than (\S+) there",
        "inference.marching.ray_steps",
        ("2 * PEAK_THICKNESS",),
    ),
    (
        "docs/understand/method-details.md",
        r"cut at (\d+) equal steps of its opacity and at (\d+) equal",
        "inference.outputs.deep_slices",
        ("CUTS + 1", "EVEN_CUTS"),
    ),
    ("docs/use/compositing.md", r"change by less than (\S+) in front", "inference.deep.thinning", ("TOLERANCE",)),
    (
        "docs/trust/stability.md",
        r"optically thicker than (\S+) are cut again, up to (\d+) times",
        "inference.marching.ray_steps",
        ("STEP_THICKNESS", "LEVELS"),
    ),
    (
        "docs/understand/method-details.md",
        r"Rays end at an optical depth of (\d+), or of (\d+) where only single scattering is wanted",
        "inference.marching.ray_march",
        ("REACH", "MAX_OPTICAL_DEPTH"),
    ),
    (
        "docs/understand/optimizations.md",
        r"rays end at an optical depth of (\d+), for single scattering alone of (\d+)",
        "inference.marching.ray_march",
        ("REACH", "MAX_OPTICAL_DEPTH"),
    ),
    (
        "docs/understand/method-details.md",
        r"scaled by a = (\d+), ([\d.]+) and ([\d.]+),",
        "inference.marching.ray_features",
        ("SCALES[0]", "SCALES[1]", "SCALES[2]"),
    ),
    (
        "docs/understand/method-details.md",
        r"none below an alpha of (\S+)\)",
        "inference.marching.depth_samples",
        ("MIN_ALPHA",),
    ),
    (
        "docs/understand/optimizations.md",
        r"all of rays of alpha below (\S+) ",
        "inference.marching.depth_samples",
        ("MIN_ALPHA",),
    ),
    (
        "docs/understand/method-details.md",
        r"turns by less than (\d+)°",
        "inference.marching.extended_lights",
        ("np.degrees(FORWARD_ANGLE)",),
    ),
    (
        "docs/understand/method-details.md",
        r"light scattered (\d+) times \(Henyey–Greenstein, G⁴\)",
        "inference.marching.extended_lights",
        ("ORDER",),
    ),
    (
        "docs/understand/method-details.md",
        r"optically thicker than ([\d.]+), the first one to (\d+) slices are integrated instead\. "
        r"Above a thickness of (\d+),",
        "inference.grids.sun_optical_depth",
        ("THIN_SLICE", "MAX_SLICES", "STEEP_SLICE"),
    ),
    (
        "docs/understand/method-details.md",
        r"Densities beyond (2\^)±(\d+) ",
        "inference.plan.precision",
        ("2", "np.log2(DENSITY_RANGE[1])"),
    ),
    (
        "docs/trust/stability.md",
        r"Densities beyond (2\^)±(\d+) ",
        "inference.plan.precision",
        ("2", "np.log2(DENSITY_RANGE[1])"),
    ),
    (
        "docs/understand/method-details.md",
        r"Optical thicknesses above (\S+) are rendered",
        "inference.plan.precision",
        ("MAX_SIGMA_HAT",),
    ),
    (
        "docs/trust/stability.md",
        r"optical densities above (\S+) render",
        "inference.plan.precision",
        ("MAX_SIGMA_HAT",),
    ),
    ("docs/understand/method-details.md", r"at least (\d+) per thread", "inference.plan.plan", ("TILES_PER_THREAD",)),
    (
        "docs/understand/method-details.md",
        r"more than (\d+) times as long as the shortest",
        "inference.plan.overlap",
        ("MAX_EXTENT_RATIO",),
    ),
    ("docs/understand/method.md", r"density pyramid has (\d+)³ cells", "inference.plan.resolution", ("LEVEL0_CELLS",)),
    ("docs/trust/speed.md", r"a pyramid of (\d+)³ cells", "inference.plan.resolution", ("LEVEL0_CELLS",)),
    (
        "docs/understand/method-details.md",
        r"to at most (\d+) voxels along an edge",
        "inference.plan.resolution",
        ("FINE_EDGE",),
    ),
    (
        "docs/understand/method-details.md",
        r"blocks of (\d+) × (\d+) × (\d+) voxels",
        "inference.scene.sparse_grid",
        ("EDGE",) * 3,
    ),
    (
        "docs/understand/method-details.md",
        r"at (\d+) × (\d+) positions per pixel",
        "inference.occluders.depth_buffer",
        ("SAMPLES", "SAMPLES"),
    ),
    (
        "docs/understand/method-details.md",
        r"per sun, (\d+) cells along its longer side",
        "inference.occluders.shadow_map",
        ("CELLS",),
    ),
    (
        "docs/understand/method-details.md",
        r"behind an optical depth of (\d+)\.",
        "inference.paper.sun_lattices",
        ("MAX_SHADOW_DEPTH",),
    ),
    ("docs/understand/method.md", r"of (\d+) radiances L_k", "inference.network.environment_features", ("CANDIDATES",)),
    (
        "docs/understand/method-details.md",
        r"There are (\d+) camera rays, .{0,30} for each (\d+) pixels up to (\d+),",
        "inference.image.environment_correction",
        ("RAYS", "PIXELS_PER_RAY", "MOST_RAYS"),
    ),
    (
        "docs/understand/method-details.md",
        r"An opaque ray has (\d+) paths, .{0,60} more than (\d+ %) uncertain.{0,250} "
        r"by ([\d.]+)² / \(([\d.]+)² \+ s²\)",
        "inference.image.environment_correction",
        ("PATHS", "CERTAIN", "EXPECTED", "EXPECTED"),
    ),
    (
        "docs/understand/method-details.md",
        r"scatters more than (\d+) times counts as the network predicts",
        "inference.marching.light_paths",
        ("COLLISIONS",),
    ),
    (
        "docs/understand/method-details.md",
        r"represented by (\d+) parallel lights",
        "inference.plan.lights",
        ("DIRECTIONS",),
    ),
    (
        "docs/understand/method-details.md",
        r"exceeds (\d+) times the mean of the rest within a cone of (\d+)°, where that is at least (\d+) %",
        "inference.scene.environment",
        ("PEAK", "np.degrees(PEAK_ANGLE)", "100 * PEAK_FRACTION"),
    ),
    ("docs/understand/method.md", r"\(S_N\) on (\d+)³ cells", "inference.transport.discrete_ordinates", ("CELLS",)),
    (
        "docs/understand/method-details.md",
        r"at most (\d+) sweeps on (\d+)³ cells and (\d+) on (\d+)³",
        "inference.transport.discrete_ordinates",
        ("SWEEPS", "CELLS // 2", "FINE_SWEEPS", "CELLS"),
    ),
    (
        "docs/understand/method-details.md",
        r"on (\d+) cells along the longest edge, .{0,60} (\d+) directions for unscattered light and (\d+) for the "
        r"rest, in (\d+) rounds",
        "inference.transport.scattered_emission",
        ("CELLS", "6 * DIRECT**2", "6 * SCATTERED**2", "ROUNDS"),
    ),
    (
        "docs/understand/method-details.md",
        r"reduced optical thickness exceeds (\d+)",
        "inference.transport.scattered_emission",
        ("THICK",),
    ),
    ("docs/understand/method.md", r"every (\d+)th of these points", "inference.features.stencil", ("SPARSE",)),
    (
        "docs/understand/method.md",
        r"at (\d+) points of the stencil",
        "inference.features.stencil",
        ("POINTS // SPARSE",),
    ),
    ("docs/understand/method.md", r"stencil of A.2 has (\d+) points", "inference.features.stencil", ("POINTS",)),
    (
        "docs/understand/method-details.md",
        r"reads (\d+) densities, their mean per layer",
        "inference.features.stencil",
        ("POINTS // SPARSE",),
    ),
    (
        "docs/understand/method-details.md",
        r"up to (\d+) times finer",
        "inference.features.mip_lattices",
        ("max(FINE)",),
    ),
    (
        "docs/understand/method-details.md",
        r"half-space without absorption, ([\d.]+) per unit irradiance",
        "inference.network.predictor",
        ("MAX_FLUENCE",),
    ),
    (
        "docs/understand/method-details.md",
        r"squares of (\d+) × \d+ pixels first.{0,150} b = (\d+ %) v / 8",
        "inference.image.adaptive_interpolation",
        ("LEVELS[0][0]", "VOXEL_DIFFERENCE[8]"),
    ),
    (
        "docs/understand/method-details.md",
        r"squares of (\d+) × \d+ pixels are tried with b = max\((\d+ %) v / 4, (\d+ %)\)",
        "inference.image.adaptive_interpolation",
        ("LEVELS[1][0]", "VOXEL_DIFFERENCE[4]", "LEVELS[1][1]"),
    ),
    (
        "docs/understand/method-details.md",
        r"squares of (\d+) × \d+ pixels with b = max\((\d+ %) v / 2, (\d+ %)\)",
        "inference.image.adaptive_interpolation",
        ("LEVELS[2][0]", "VOXEL_DIFFERENCE[2]", "LEVELS[2][1]"),
    ),
    (
        "docs/understand/method-details.md",
        r"√n \+ ([\d.]+) s",
        "inference.image.adaptive_interpolation",
        ("NOISE",),
    ),
    (
        "docs/understand/method.md",
        r"a residual network of four layers, (\d+) wide",
        "training.networks.mrpnn",
        ("WIDTH",),
    ),
    (
        "docs/understand/method.md",
        r"for (\d+) scattering orders n from (\d+) to (\d+)",
        "training.networks.mrpnn",
        ("len(ORDERS)", "ORDERS[0]", "ORDERS[-1]"),
    ),
    (
        "docs/understand/method.md",
        r"\| `mrpnn` .{0,30} \| (\d+) (\d+) \| (\d+) densities, (\d+) values of light, (\d+) gathered",
        "training.networks.mrpnn",
        (
            "sum(weights.numel() for weights in RayMRPNN().parameters()) // 1000",
            "sum(weights.numel() for weights in RayMRPNN().parameters()) % 1000",
            "POINTS",
            "RAY_INPUTS",
            "math.prod(GATHERED)",
        ),
    ),
    (
        "docs/understand/method.md",
        r"log-uniform in (\d+) to (\d+)",
        "training.data.targets",
        ("SIGMA_HAT_RANGE[0]", "SIGMA_HAT_RANGE[1]"),
    ),
    (
        "docs/understand/method-details.md",
        r"deviation is ([\d.]+) times the sum",
        "inference.image.predicted_error",
        ("JOINED",),
    ),
    (
        "docs/understand/method-details.md",
        r"trained range, ([\d.]+) per factor of e in σ̂ and (\d+) per factor",
        "inference.network.predictor",
        ("BEYOND_THICKNESS", "BEYOND_ANISOTROPY"),
    ),
    (
        "docs/understand/method-details.md",
        r"lamps in or near volumes it is ([\d.]+)",
        "inference.network.prepared_predictors",
        ("NEARBY_DEVIATION",),
    ),
    (
        "docs/understand/method-details.md",
        r"network blend from r = ([\d.]+) to r = ([\d.]+)\.",
        "inference.network.lamp_nearby",
        ("NEAR", "FAR"),
    ),
    (
        "docs/understand/method-details.md",
        r"\| up to (\d+) \| 26 fixed ones",
        "inference.baking.directions",
        ("NODES",),
    ),
    (
        "docs/understand/method-details.md",
        r"shows: (\d+) for a fixed direction, (\d+) for an anchor",
        "inference.baking.directions",
        ("SMOOTH_PREDICTIONS", "PREDICTIONS"),
    ),
    (
        "docs/understand/method-details.md",
        r"\| up to (\d+) \| (\d+) anchors",
        "inference.baking.directions",
        ("FINE_NODES", "len(ANCHORS) - 1"),
    ),
    (
        "docs/understand/method-details.md",
        r"are an optical depth of ([\d.]+) apart, but at least (\d+) are",
        "inference.baking.directions",
        ("SPACING", "LEAST_NODES"),
    ),
    ("docs/trust/stability.md", r"anisotropy beyond ±([\d.]+),", "inference.scene.description", ("MAX_ANISOTROPY",)),
    ("docs/trust/stability.md", r"irradiance above (\S+);", "inference.scene.description", ("MAX_IRRADIANCE",)),
    ("docs/trust/stability.md", r"take more than (\S+) steps", "inference.image.camera_pass", ("MAX_STEPS",)),
    (
        "docs/use/preferences.md",
        r"(\d+) random points are evaluated .{0,120} differs by more than (\d+ %)",
        "inference.network.provider",
        ("TRIAL_POINTS", "TOLERANCE"),
    ),
]
# The same of modules that need Blender.
ADDON_FACTS = [
    (
        "docs/trust/stability.md",
        r"more than (\S+) voxels in blocks that hold something, or (\S+) in their box",
        "vdb.density_grid",
        ("MAX_VOXELS", "MAX_SPAN"),
    ),
    (
        "docs/understand/optimizations.md",
        r"up to (\S+) voxels, of which blocks with (\S+) hold something",
        "vdb.density_grid",
        ("MAX_SPAN", "MAX_VOXELS"),
    ),
    (
        "docs/understand/optimizations.md",
        r"Grids of more than (\S+) voxels keep only blocks",
        "vdb.density_grid",
        ("DENSE_SPAN",),
    ),
    (
        "docs/use/settings.md",
        r"\*Preview\*: (\d+) depth sample.{0,120} \*Draft\*: (\d+) depth samples.{0,80} \*Final\*: (\d+) depth samples",
        "settings.properties",
        ("PRESETS['PREVIEW']", "PRESETS['DRAFT']", "PRESETS['FINAL']"),
    ),
    (
        "docs/use/world.md",
        r"samples, or (\d+) where neighbouring pixels differ",
        "scene.film",
        ("SAMPLES",),
    ),
    (
        "docs/use/baked-light.md",
        r"in Blender 4 also a \*Step Rate Render\* of (\d+),",
        "baking.fast_settings",
        ("STEP_RATE",),
    ),
    (
        "docs/use/comparison.md",
        r"depth samples, which is judged, and with (\d+), (\d+), (\d+) and (\d+);",
        "comparison.run",
        tuple(f"DEPTHS[{n}]" for n in range(4)),
    ),
]


def page(name):
    return " ".join((ROOT / name).read_text().split())


def number(text: str) -> float:
    """The number that a text like 0.6, 1e12, 3 %, 2^29, 2³⁴ or 256³ stands for."""
    text = re.sub(
        "[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: "^" + found.group().translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")), text
    ).rstrip(",;.")
    if text.endswith("%"):
        return float(text[:-1]) / 100.0
    base, _, exponent = text.partition("^")
    return float(base) ** (float(exponent) if exponent else 1.0)


def check(document, sentence, module, values):
    found = re.search(sentence, page(document))
    assert found, f"{document} no longer says: {sentence}"
    stated = [number(text) for text in found.groups()]
    assert stated == pytest.approx([float(eval(value, dict(vars(module)))) for value in values]), found.group()


@pytest.mark.parametrize(
    "document, sentence, module, values", FACTS, ids=[f"{fact[0]}: {fact[3][0]}" for fact in FACTS]
)
def test_constants_are_those_of_the_code(document, sentence, module, values):
    check(document, sentence, importlib.import_module(module), values)


@pytest.mark.parametrize(
    "document, sentence, module, values", ADDON_FACTS, ids=[f"{f[0]}: {f[3][0]}" for f in ADDON_FACTS]
)
def test_constants_are_those_of_the_extension(addon, document, sentence, module, values):
    check(document, sentence, importlib.import_module(f"{addon.__name__}.mrpnn_addon.{module}"), values)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_paths_and_commands_exist(path):
    text = path.read_text()
    quoted = set(re.findall(r"`([\w.-]+(?:/[\w.*-]*)+|[\w-]+\.(?:py|md|toml))`", text))
    paths = {name for name in quoted if name.split("/")[0] not in MADE}
    # Networks are named by their files.
    networks = ROOT / "inference" / "weights"
    missing = [
        name for name in paths if not list(ROOT.glob(name.rstrip("/"))) and not (networks / f"{name}.onnx").exists()
    ]
    assert missing == []
    modules = set(re.findall(r"python\S* -m\s+((?:benchmarks|training|inference)[\w.]*)", text))
    files = {module: ROOT.joinpath(*module.rstrip(".").split(".")) for module in modules}
    assert [
        module
        for module, file in files.items()
        if not file.with_suffix(".py").exists() and not (file / "__main__.py").exists()
    ] == []


def anchors(path):
    """The anchors that a forge gives a page's headings."""
    headings = re.findall(r"^#+ (.+)$", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", path.read_text()):
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        if "://" not in link and not (target.exists() and (not anchor or anchor in anchors(target))):
            wrong.append(link)
    assert wrong == []


def test_every_table_is_linked():
    text = "".join(path.read_text() for path in PAGES)
    tables = sorted((ROOT / "docs" / "tables").glob("*.csv"))
    assert tables and [path.name for path in tables if f"tables/{path.name})" not in text] == []


def test_checksums_are_those_of_the_weights_files():
    rows = dict(
        re.findall(
            r"^\| `([\w-]+)\.onnx` \| ([0-9a-f]{12}) \|",
            (ROOT / "docs/understand/weights.md").read_text(),
            re.MULTILINE,
        )
    )
    files = [*(ROOT / "inference/weights").glob("*.sha256"), *(ROOT / "training/rpnn").glob("*.sha256")]
    found = {path.stem: path.read_text()[:12] for path in files}
    assert rows == found
