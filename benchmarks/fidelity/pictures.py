# SPDX-License-Identifier: GPL-3.0-or-later
"""Each system's image beside the reference, with its signed error below."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

EDGE, CAPTION, GAP = 288, 22, 4
PAPER, INK = (24, 24, 24), (230, 230, 230)


def shown(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """(H, W, 3) linear as display values in [0, 1]."""
    return np.clip(radiance * exposure, 0.0, 1.0) ** (1 / 2.2)


def signed_error(difference: np.ndarray, exposure: float) -> np.ndarray:
    """(H, W, 3): red where too bright, blue where too dark, white where equal."""
    error = difference.mean(axis=-1) * exposure
    red, blue = np.clip(error, 0, 1), np.clip(-error, 0, 1)
    return np.clip(np.stack([1.0 - blue, 1.0 - red - blue, 1.0 - red], axis=-1), 0.0, 1.0)


def _panel(values: np.ndarray, caption: str) -> Image.Image:
    image = Image.fromarray((values * 255.0 + 0.5).astype(np.uint8)).resize((EDGE, EDGE), Image.NEAREST)
    sheet = Image.new("RGB", (EDGE, EDGE + CAPTION), PAPER)
    sheet.paste(image, (0, CAPTION))
    ImageDraw.Draw(sheet).text((4, 3), caption, INK, ImageFont.load_default(13))
    return sheet


def picture(layers: dict, a: np.ndarray, b: np.ndarray) -> Image.Image:
    """The reference and the systems above, the systems' signed errors at the same exposure below.

    layers: radiance (H, W, 3) by system; a, b: the reference's halves.
    """
    reference = 0.5 * (a + b)
    exposure = 0.7 / max(np.percentile(reference, 99), 1e-9)
    blank = Image.new("RGB", (EDGE, EDGE + CAPTION), PAPER)
    columns = [(_panel(shown(reference, exposure), "path traced, both halves"), blank)]
    for name, rgb in layers.items():
        error = signed_error(rgb - reference, exposure)
        columns.append((_panel(shown(rgb, exposure), name), _panel(error, f"{name}: red too bright, blue too dark")))
    step = EDGE + GAP
    sheet = Image.new("RGB", (step * len(columns) - GAP, 2 * (EDGE + CAPTION)), PAPER)
    for i, (above, below) in enumerate(columns):
        sheet.paste(above, (i * step, 0))
        sheet.paste(below, (i * step, EDGE + CAPTION))
    return sheet
