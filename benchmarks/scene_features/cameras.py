"""Cameras."""


def orthographic(stage):
    stage.camera.data.type, stage.camera.data.ortho_scale = 'ORTHO', 2.4


def shifted(stage):
    stage.camera.data.shift_x, stage.camera.data.shift_y = 0.15, -0.1
    stage.camera.data.sensor_fit = 'VERTICAL'
    stage.scene.render.resolution_y = int(stage.scene.render.resolution_x * 0.75)


def clipped(stage):
    distance = stage.camera.location.length
    stage.camera.data.clip_start, stage.camera.data.clip_end = distance - 0.1, distance + 0.5


MEASURED = {
    "Orthographic": orthographic,
    "Lens shift, vertical sensor fit": shifted,
    "Clip range through the volume": clipped,
}
