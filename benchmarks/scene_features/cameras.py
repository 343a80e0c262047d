"""Cameras."""


def orthographic(stage):
    stage.camera.data.type, stage.camera.data.ortho_scale = 'ORTHO', 2.4


def shifted(stage):
    stage.camera.data.shift_x, stage.camera.data.shift_y = 0.15, -0.1
    stage.camera.data.sensor_fit = 'VERTICAL'
    stage.scene.render.resolution_y = int(stage.scene.render.resolution_x * 0.75)


MEASURED = {
    "Orthographic": orthographic,
    "Lens shift, vertical sensor fit": shifted,
}
