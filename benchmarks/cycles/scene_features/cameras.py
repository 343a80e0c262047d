# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras."""

from mathutils import Vector

from .stage import aim


def orthographic(stage):
    stage.camera.data.type, stage.camera.data.ortho_scale = "ORTHO", 2.4


def shifted(stage):
    stage.camera.data.shift_x, stage.camera.data.shift_y = 0.15, -0.1
    stage.camera.data.sensor_fit = "VERTICAL"
    stage.scene.render.resolution_y = int(stage.scene.render.resolution_x * 0.75)


def panorama(stage):
    """All around, from so near that the cloud fills a good part of it."""
    aim(stage.camera, Vector((0.6, -1.5, 0.4)))
    stage.camera.data.type = "PANO"
    stage.camera.data.panorama_type = "EQUIRECTANGULAR"
    stage.scene.render.resolution_x = 2 * stage.scene.render.resolution_y


MEASURED = {
    "Orthographic": orthographic,
    "Lens shift, vertical sensor fit": shifted,
    "Equirectangular panorama": panorama,
}
