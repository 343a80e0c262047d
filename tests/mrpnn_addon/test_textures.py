# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture nodes in numpy, against Cycles' render of a glowing plane."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import glowing_plane
from tests.support.glowing_plane import add, assert_equal_to_cycles, axes, combined


@pytest.fixture
def tilted(addon, scene):
    """(scene, node tree, emission, vector, number): a vector and a number that vary in all their components."""
    tree, emission, coordinates = glowing_plane.make(scene)
    mapping = add(tree, "Mapping")
    mapping.inputs["Rotation"].default_value = 0.7, -0.5, 0.3
    mapping.inputs["Location"].default_value = 3.3, -1.2, 5.0
    tree.links.new(coordinates, mapping.inputs["Vector"])
    number = add(tree, "Math", operation="MULTIPLY_ADD")
    number.inputs[1].default_value, number.inputs[2].default_value = 0.83, -1.7
    tree.links.new(axes(tree, coordinates)[1], number.inputs[0])
    return scene, tree, emission, mapping.outputs[0], number.outputs[0]


def texture(tilted, kind, sockets=(), **settings):
    """A texture node of the tilted vector and number; sockets: values by name."""
    _, tree, _, vector, number = tilted
    node = add(tree, kind, **settings)
    # By identifier: names find only sockets that are shown.
    inputs = {socket.identifier: socket for socket in node.inputs}
    for name, value in dict(sockets).items():
        inputs[name].default_value = value
    for output, name in ((vector, "Vector"), (number, "W")):
        if name in inputs:
            tree.links.new(output, inputs[name])
    return node


def check(tilted, folder, outputs, what):
    """Compare outputs, three numbers or colours at a time, with Cycles."""
    scene, tree, emission, _, _ = tilted
    numbers = []
    for output in outputs:
        numbers += axes(tree, output) if output.type != "VALUE" else [output]
    for first in range(0, len(numbers), 3):
        combined(tree, emission, numbers[first : first + 3])
        try:
            assert_equal_to_cycles(scene, folder, emission)
        except AssertionError as difference:
            raise AssertionError(f"{what}: {difference}") from None


@pytest.mark.parametrize("dimensions", ["1D", "2D", "3D", "4D"])
def test_noise(tilted, tmp_path, dimensions):
    for kind in ("FBM", "MULTIFRACTAL", "HETERO_TERRAIN", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL"):
        for detail in (0.0, 2.6):
            sockets = dict(Scale=1.3, Detail=detail, Roughness=0.6, Lacunarity=2.3, Distortion=0.4)
            sockets.update(Offset=0.7, Gain=1.4)
            node = texture(tilted, "TexNoise", sockets, noise_dimensions=dimensions, noise_type=kind)
            check(tilted, tmp_path, [node.outputs["Color"]], (kind, detail))


def test_noise_whose_settings_vary(tilted, tmp_path):
    _, tree, _, _, number = tilted
    node = texture(tilted, "TexNoise", dict(Scale=1.5))
    for name in ("Detail", "Roughness", "Lacunarity", "Distortion"):
        tree.links.new(number, node.inputs[name])
    check(tilted, tmp_path, [node.outputs["Fac"]], "noise")


@pytest.mark.slow
@pytest.mark.parametrize("dimensions", ["1D", "2D", "3D", "4D"])
@pytest.mark.parametrize("feature", ["F1", "F2", "SMOOTH_F1"])
def test_voronoi(tilted, tmp_path, feature, dimensions):
    cases = [("EUCLIDEAN", 0.0, False), ("MANHATTAN", 1.6, True), ("CHEBYCHEV", 2.0, True), ("MINKOWSKI", 0.0, True)]
    if feature == "SMOOTH_F1":
        cases = cases[1 : 2 if dimensions == "4D" else 3]
    for metric, detail, normalize in cases[: 2 if dimensions == "1D" else None]:
        sockets = dict(Scale=1.2, Detail=detail, Roughness=0.6, Lacunarity=1.7, Smoothness=0.8, Exponent=1.6)
        node = texture(
            tilted,
            "TexVoronoi",
            {**sockets, "Randomness": 0.9},
            voronoi_dimensions=dimensions,
            feature=feature,
            distance=metric,
            normalize=normalize,
        )
        outputs = {"1D": ("W",), "4D": ("Position", "W")}.get(dimensions, ("Position",))
        outputs = [node.outputs[name] for name in ("Color", *outputs, "Distance")]
        check(tilted, tmp_path, outputs, (metric, detail, normalize))


@pytest.mark.parametrize("dimensions", ["1D", "2D", "3D", "4D"])
def test_voronoi_edges_and_radii(tilted, tmp_path, dimensions):
    settings = dict(voronoi_dimensions=dimensions)
    outputs = []
    for detail, normalize in ((0.0, False), (1.7, True)):
        sockets = dict(Scale=1.2, Detail=detail, Roughness=0.7, Lacunarity=1.8, Randomness=0.8)
        node = texture(tilted, "TexVoronoi", sockets, feature="DISTANCE_TO_EDGE", normalize=normalize, **settings)
        outputs.append(node.outputs["Distance"])
    node = texture(tilted, "TexVoronoi", dict(Scale=1.2), feature="N_SPHERE_RADIUS", **settings)
    check(tilted, tmp_path, [*outputs, node.outputs["Radius"]], dimensions)


def test_wave(tilted, tmp_path):
    outputs = []
    sockets = {"Scale": 0.4, "Detail Scale": 1.3, "Detail Roughness": 0.6, "Phase Offset": 0.9}
    for n, direction in enumerate(("X", "Y", "Z", "DIAGONAL", "X", "Y", "Z", "SPHERICAL")):
        kind, side = ("BANDS", "bands_direction") if n < 4 else ("RINGS", "rings_direction")
        profile = ("SIN", "SAW", "TRI")[n % 3]
        distortion = {"Distortion": 1.2 * (n % 2), "Detail": 1.5 * (n % 3)}
        node = texture(
            tilted, "TexWave", {**sockets, **distortion}, wave_type=kind, wave_profile=profile, **{side: direction}
        )
        outputs.append(node.outputs["Fac"])
    check(tilted, tmp_path, outputs, "wave")


@pytest.mark.parametrize("depth", [0, 1, 4, 10])
def test_magic(tilted, tmp_path, depth):
    node = texture(tilted, "TexMagic", dict(Scale=0.6, Distortion=1.1), turbulence_depth=depth)
    check(tilted, tmp_path, [node.outputs["Color"], node.outputs["Fac"]], depth)


def test_checker_brick_and_gradient(tilted, tmp_path):
    outputs = []
    for kind, settings in (
        ("TexChecker", {}),
        ("TexBrick", dict(offset=0.3, offset_frequency=3, squash=0.6, squash_frequency=2)),
    ):
        node = texture(tilted, kind, dict(Scale=2.3), **settings)
        node.inputs["Color1"].default_value = 0.9, 0.2, 0.4, 1.0
        node.inputs["Color2"].default_value = 0.1, 0.8, 0.3, 1.0
        outputs += [node.outputs["Color"], node.outputs["Fac"]]
    node = texture(tilted, "TexBrick", {"Scale": 1.7, "Mortar Size": 0.09, "Mortar Smooth": 0.7, "Bias": -0.2})
    outputs += [node.outputs["Fac"], texture(tilted, "TexGradient").outputs["Fac"]]
    check(tilted, tmp_path, outputs, "patterns")


@pytest.mark.parametrize("dimensions", ["1D", "2D", "3D", "4D"])
def test_white_noise(tilted, tmp_path, dimensions):
    """Of whole numbers, since any bit counts."""
    scene, tree, emission, vector, number = tilted
    node = add(tree, "TexWhiteNoise", noise_dimensions=dimensions)
    whole, floor = add(tree, "VectorMath", operation="FLOOR"), add(tree, "Math", operation="FLOOR")
    inputs = {socket.identifier: socket for socket in node.inputs}
    for output, step, name in ((vector, whole, "Vector"), (number, floor, "W")):
        tree.links.new(output, step.inputs[0])
        tree.links.new(step.outputs[0], inputs[name])
    check(tilted, tmp_path, [node.outputs["Color"], node.outputs["Value"]], dimensions)


@pytest.mark.skipif(bpy.app.version < (4, 3, 0), reason="Blender 4.3 has the first Gabor Texture")
@pytest.mark.parametrize("dimensions", ["2D", "3D"])
def test_gabor(tilted, tmp_path, dimensions):
    for anisotropy in (0.6, 1.0):
        sockets = {"Scale": 0.8, "Frequency": 1.7, "Anisotropy": anisotropy, "Orientation 2D": 0.4}
        sockets["Orientation 3D"] = 0.3, -0.8, 0.5
        node = texture(tilted, "TexGabor", sockets, gabor_type=dimensions)
        outputs = [node.outputs[name] for name in ("Value", "Phase", "Intensity")]
        check(tilted, tmp_path, outputs, anisotropy)


def picture(is_float, space, columns=7, rows=5):
    """An opaque image of random colours."""
    image = bpy.data.images.new("Picture", columns, rows, float_buffer=is_float)
    image.colorspace_settings.name = space
    colours = np.random.default_rng(3).random((rows, columns, 4)).astype(np.float32)
    colours[..., 3] = 1.0
    image.pixels.foreach_set(colours.ravel())
    image.pack()
    return image


@pytest.mark.parametrize("extension", ["REPEAT", "EXTEND", "CLIP", "MIRROR"])
def test_images(tilted, tmp_path, extension):
    for interpolation, is_float, space in (
        ("Linear", False, "sRGB"),
        ("Closest", False, "Non-Color"),
        ("Cubic", True, "Linear Rec.709"),
    ):
        node = texture(tilted, "TexImage", interpolation=interpolation, extension=extension)
        node.image = picture(is_float, space)
        # Onto the image and around it.
        shift = add(tilted[1], "VectorMath")
        shift.inputs[1].default_value = -2.9, 1.7, -5.0
        tilted[1].links.new(tilted[3], shift.inputs[0])
        tilted[1].links.new(shift.outputs[0], node.inputs["Vector"])
        check(tilted, tmp_path, [node.outputs["Color"], node.outputs["Alpha"]], interpolation)


@pytest.mark.parametrize("projection", ["SPHERE", "TUBE"])
def test_projected_images(tilted, tmp_path, projection):
    node = texture(tilted, "TexImage", projection=projection)
    node.image = picture(True, "Linear Rec.709")
    check(tilted, tmp_path, [node.outputs["Color"]], projection)


def test_images_that_cannot_be_read_are_named(tilted):
    node = texture(tilted, "TexImage")
    tilted[1].links.new(node.outputs["Color"], tilted[2].inputs["Color"])
    node.image = picture(False, "sRGB")
    node.image.pixels[3] = 0.5
    for problem in ("transparent", "missing"):
        with pytest.raises(Exception, match=problem):
            glowing_plane.evaluated(tilted[2])
        node.image = None
