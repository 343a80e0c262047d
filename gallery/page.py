# SPDX-License-Identifier: GPL-3.0-or-later
"""The gallery's page, docs/use/gallery.md, of pictures and figures that the docs hold."""

from pathlib import Path

from PIL import Image

from benchmarks.support.pages import DOCS, IMAGES, TABLES, csv_text, read_csv, replace
from benchmarks.support.provenance import made_by

from .scenes import SCENES

PAGE, PICTURES, TABLE = DOCS / "use" / "gallery.md", IMAGES / "gallery", TABLES / "gallery.csv"
PICTURE_SECONDS, SAMPLES = "picture's seconds", "Cycles' samples"
MEASURED = ("seconds", "Cycles' seconds", SAMPLES, "error", "Cycles' error", "reference's samples")
COLUMNS = ("scene", "way", "pixels", PICTURE_SECONDS, *MEASURED, "made by")
QUALITY = 88
#: README's first picture: a large one, and two beside it. Below are all others: the size of each, how many in a row.
FIRST, FIRST_HEIGHT, GAP = ("dusk", "fog", "storm"), 484, 4
TILE, COLUMNS_SHOWN = (320, 180), 4
#: The steps of the workflow.
STEPS = {
    "engine-menu": "1. Choose the engine",
    "panel": "2. Check",
    "viewport": "3. Light it in Rendered shading",
    "render": "4. Press F12",
}
WAYS = {
    "layer": "engine *MRPNN Volumes*",
    "composite": "[*Composite over Cycles*](composite.md)",
    "bake": "[*Bake Light*](baked-light.md), shown by Cycles",
}
HEAD = """# Gallery

Eleven scenes of the kinds that artists light: start from them, or see what a setting does.

## Get the scenes

1. [Install the extension](install.md) and enable it. Most of the scenes use its engine.
2. Take the zip whose name begins with `mrpnn-gallery` from a release. It fits all platforms and Blender 4.2 to 5.2.
3. In the menu of the Blender icon, choose *Install Application Template* and this zip.
4. *File > New* now lists the scenes, such as *Volumes Cumulus at noon*. Render it as its entry below says.

A saved scene reads its volumes from the template's folder. Copy them from there before another machine renders it.

## Make the scenes

Scripts make the volumes and the .blend files. In a clone of the repository:

    .venv/bin/python -m gallery noon
    .venv/bin/python -m gallery --templates

The first command makes one scene and its picture, in `build/gallery`. The second makes `mrpnn-gallery.zip` there.

## The pictures

Below each picture is a smaller one beside Cycles: 1024 bounces, denoised, after about the same processor seconds.
Cycles has at least one sample per pixel, even where that takes longer. Where an entry states errors, they are relative
RMSE over the whole picture, against a longer render by Cycles without denoising.
"""


def enter(name: str, out: Path, figures: dict, arguments) -> None:
    """Put a scene's pictures and figures from a folder into the docs."""
    PICTURES.mkdir(exist_ok=True)
    for path in (out / f"{name}.png", out / f"{name}-cycles.png"):
        if path.exists():
            with Image.open(path) as image:
                image.convert("RGB").save(PICTURES / f"{path.stem}.jpg", quality=QUALITY, optimize=True)
    rows = {row["scene"]: row for row in read_csv(TABLE)} if TABLE.exists() else {}
    rows[name] = {"scene": name, **figures, "made by": made_by("gallery", arguments)}
    ordered = [[rows[key].get(column) or "" for column in COLUMNS] for key in SCENES if key in rows]
    replace(TABLE, csv_text([], COLUMNS, ordered))


def text() -> str:
    """The page."""
    parts = [HEAD]
    for row in read_csv(TABLE):
        name, entry = row["scene"], SCENES[row["scene"]]
        pixels = row["pixels"].replace("x", "×")
        said = f"{entry.text} Rendered by {WAYS[row['way']]}: {pixels} pixels"
        said += f", {row[PICTURE_SECONDS]} processor seconds." if row[PICTURE_SECONDS] else "."
        picture = f"![{entry.title}, as rendered](../images/gallery/{name}.jpg)"
        parts.append(f"### {entry.title}\n\n{picture}\n\n{said}\n")
        if row[SAMPLES]:
            samples = f"{row[SAMPLES]} sample"
            samples += "" if samples.startswith("1 ") else "s"
            alt = f"{entry.title}: by this extension at the left, by Cycles with {samples} at the right"
            said = f"Cycles has {samples} per pixel here."
            if row.get("error"):
                own, other = (row[column].partition(" (")[0] for column in ("error", "Cycles' error"))
                said += f" The error of this extension is {own}, and that of Cycles {other}."
            parts.append(f"![{alt}](../images/gallery/{name}-cycles.jpg)\n\n{said}\n")
    parts.append("All figures are in [gallery.csv](../tables/gallery.csv), with the commands that made them.\n")
    return "\n".join(parts)


def sheet() -> Image.Image:
    """The pictures that the docs hold but FIRST, side by side in rows."""
    paths = [PICTURES / f"{name}.jpg" for name in SCENES if name not in FIRST]
    width, height = TILE[0] + GAP, TILE[1] + GAP
    made = Image.new("RGB", (COLUMNS_SHOWN * width - GAP, -(-len(paths) // COLUMNS_SHOWN) * height - GAP))
    for number, path in enumerate(paths):
        made.paste(_resized(path, TILE), (number % COLUMNS_SHOWN * width, number // COLUMNS_SHOWN * height))
    return made


def hero() -> Image.Image:
    """A picture, and two smaller ones one above the other, all of 16 by 9."""
    paths, small = [PICTURES / f"{name}.jpg" for name in FIRST], (FIRST_HEIGHT - GAP) // 2
    widths = [round(height * 16 / 9) for height in (FIRST_HEIGHT, small)]
    made = Image.new("RGB", (widths[0] + GAP + widths[1], FIRST_HEIGHT))
    made.paste(_resized(paths[0], (widths[0], FIRST_HEIGHT)))
    for number, path in enumerate(paths[1:]):
        made.paste(_resized(path, (widths[1], small)), (widths[0] + GAP, number * (small + GAP)))
    return made


def _resized(path: Path, size: tuple[int, int]) -> Image.Image:
    with Image.open(path) as image:
        return image.resize(size, Image.LANCZOS)


def steps() -> Image.Image:
    """The workflow in four screenshots, which tests of windows take."""
    from benchmarks.support.pictures import row

    shown = []
    for name, caption in STEPS.items():
        picture = Image.open(IMAGES / f"{name}.png").convert("RGB")
        # The panel's upper part, at a size that can be read.
        shown.append((caption, picture.crop((0, 0, picture.width, 300)) if name == "panel" else picture))
    return row(shown, 260, 15)


def write() -> None:
    """Write the page, and the pictures of README that are made of others."""
    replace(PAGE, text())
    hero().save(IMAGES / "hero.jpg", quality=QUALITY, optimize=True)
    sheet().save(IMAGES / "gallery.jpg", quality=QUALITY, optimize=True)
    steps().save(IMAGES / "workflow.jpg", quality=QUALITY, optimize=True)
