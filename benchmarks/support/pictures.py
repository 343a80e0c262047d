# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures to look at: view-transformed images, signed error maps, captioned rows of both."""

import tempfile
from pathlib import Path

import bpy
import numpy as np
from PIL import Image, ImageDraw, ImageFont

GAP = 6
PAPER = (24, 24, 24)
INK = (230, 230, 230)
TOO_DARK, TOO_BRIGHT = np.array([0.13, 0.40, 0.67]), np.array([0.70, 0.09, 0.17])
SKY_HORIZON, SKY_ZENITH = np.array([0.35, 0.50, 0.72]), np.array([0.06, 0.14, 0.34])


def over_sky(rgba: np.ndarray) -> np.ndarray:
    """Premultiplied linear (H, W, 4) over a plain evening sky: linear (H, W, 3)."""
    height = (np.arange(rgba.shape[0], dtype=np.float32) + 0.5)[:, None, None] / rgba.shape[0]
    sky = SKY_ZENITH * (1.0 - height) + SKY_HORIZON * height
    return rgba[..., :3] + (1.0 - rgba[..., 3:]) * sky


def view_transformed(linear: np.ndarray, scene) -> Image.Image:
    """Scene-linear (H, W, 3) as the scene's view transform shows it, by Blender itself."""
    height, width = linear.shape[:2]
    image = bpy.data.images.new("view", width, height, float_buffer=True)
    try:
        opaque = np.concatenate([linear, np.ones((height, width, 1))], axis=-1).astype(np.float32)
        image.pixels.foreach_set(opaque[::-1].ravel())
        scene.render.image_settings.file_format = "PNG"
        scene.render.image_settings.color_mode = "RGB"
        scene.render.image_settings.color_depth = "8"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "view.png"
            image.save_render(str(path), scene=scene)
            return Image.open(path).convert("RGB")
    finally:
        bpy.data.images.remove(image)


def pixels(image_name: str) -> np.ndarray:
    """A float Image data-block as (H, W, 4), rows from the top."""
    image = bpy.data.images[image_name]
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[::-1]


def signed_map(error: np.ndarray, limit: float) -> Image.Image:
    """(H, W) as colours: red where too bright, blue where too dark, white at 0, saturated at `limit`."""
    share = np.clip(error / limit, -1.0, 1.0)[..., None]
    colour = np.where(share > 0, TOO_BRIGHT, TOO_DARK)
    mapped = 1.0 + np.abs(share) * (colour - 1.0)
    return Image.fromarray((255 * mapped + 0.5).astype(np.uint8))


def row(panels: list[tuple[str, Image.Image]], height: int, text: int = 15) -> Image.Image:
    """Pictures side by side at one height, each under its caption of one or more lines; text: height of a line."""
    scaled = [
        (
            caption,
            picture.resize(
                (round(picture.width * height / picture.height), height),
                Image.LANCZOS if picture.height > height else Image.NEAREST,
            ),
        )
        for caption, picture in panels
    ]
    width = sum(picture.width for _, picture in scaled) + GAP * (len(scaled) - 1)
    top = round(1.3 * text * max(caption.count("\n") + 1 for caption, _ in scaled)) + 6
    sheet = Image.new("RGB", (width, height + top), PAPER)
    draw, font, x = ImageDraw.Draw(sheet), ImageFont.load_default(text), 0
    for caption, picture in scaled:
        draw.text((x + 4, 4), caption, INK, font)
        sheet.paste(picture, (x, top))
        x += picture.width + GAP
    return sheet
