# SPDX-License-Identifier: GPL-3.0-or-later
"""Doors: the ways through which a scene is sent, each judged by what must hold whatever the scene is.

A later door is a function here and its entry in DOORS. Each raises AssertionError that says what does not hold.
"""

import functools
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np

from tests.support import blender_scenes

from .covering import Row
from .exr import read_deep
from .features import SIZE, Stage, is_dark
from .pictures import (
    PARTS,
    Picture,
    check_near,
    check_range,
    check_same,
    image_pixels,
    read_picture,
    render,
    write_passes,
)

# Pictures of one scene by different doors, relative to the brightest value.
SAME = 2e-3
# The viewport's, whose camera comes from matrices in single precision: an edge of a surface may cross a pixel's middle.
SHOWN = 3e-3
# Means of two eyes, which see a scene from 0.4 apart at a distance of 4.5.
EYES = 0.2
# Light of the bake along its rays beside the layer's, relative to the mean: of the mean, and of pixels, as means of
# FILTER x FILTER rays: baked voxels are half a pixel wide, and one ray may pass an edge that they blur.
BAKED_MEAN, BAKED, FILTER = 0.1, 0.25, 4
# Alpha beside Cycles', whose noise at so few samples is a third of this.
CYCLES_SAMPLES, CYCLES_MEAN = 256, 0.02
# Why Bake Light and Compare with Cycles refuse a scene in which nothing shines; the other doors show it black.
REFUSAL = "the scene shows no sun and no lamp"
# Debian's Cycles of 5.2 shows no volumes, and Compare with Cycles says so.
CYCLES_IS_BROKEN = bool(bpy.app.binary_path) and bpy.app.version >= (5, 0, 0)
BROKEN_CYCLES = "does not render volumes correctly here"


@dataclass
class Shot:
    """A row's scene. package: the extension."""

    row: Row
    stage: Stage
    package: ModuleType

    @property
    def scene(self) -> "bpy.types.Scene":
        return self.stage.scene

    @property
    def transparent(self) -> bool:
        return self.scene.render.film_transparent

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Of the views' files."""
        return ("_L", "_R") if self.scene.render.use_multiview else ("",)

    @functools.cached_property
    def pictures(self) -> dict[str, Picture]:
        """What F12 makes of it, by the views' suffixes: the reference of other doors."""
        write_passes(self.scene)
        return render(self.scene, self.stage.folder, self.suffixes)

    @functools.cached_property
    def picture(self) -> Picture:
        """What F12 makes of it, seen from the camera itself."""
        if not self.scene.render.use_multiview:
            return self.pictures[""]
        self.scene.render.use_multiview = False
        write_passes(self.scene)
        try:
            return render(self.scene, self.stage.folder)[""]
        finally:
            self.scene.render.use_multiview = True

    def folder(self, name: str) -> Path:
        made = self.stage.folder / name
        made.mkdir(exist_ok=True)
        return made


def refuses(shot: Shot, call: Callable[[], object]) -> bool:
    """Call an operator; whether it refuses the scene because nothing shines in it, and only then."""
    try:
        call()
    except RuntimeError as error:
        assert REFUSAL in str(error) and is_dark(shot.row), f"refused: {error}"
        return True
    assert not is_dark(shot.row), "a scene without light is not refused"
    return False


def check_scene(shot: Shot) -> None:
    """Every row goes through this door, too: it is quick."""
    bpy.ops.mrpnn.check()


def f12(shot: Shot) -> None:
    """Every view's parts and light groups add up to the whole, and twice the light is twice as bright."""
    scene, pictures = shot.scene, shot.pictures
    for suffix, picture in pictures.items():
        check_sums(shot, picture)
        # Two eyes, near each other, see much the same.
        apart = abs(picture.layer().mean() - shot.picture.layer().mean())
        assert apart <= EYES * shot.picture.layer().mean(), f"view {suffix} differs by {apart:.3g} in the mean"
    double_the_light(scene)
    for suffix, brighter in render(scene, shot.stage.folder, shot.suffixes).items():
        check_same(f"twice the light{suffix}", brighter.layer(), 2.0 * pictures[suffix].layer(), SAME)
        alphas = (one.channels["ViewLayer.Combined.A"] for one in (brighter, pictures[suffix]))
        check_same(f"alpha in twice the light{suffix}", *alphas, SAME)


def check_sums(shot: Shot, picture: Picture) -> None:
    """The parts and the light groups of each view layer add up to the whole."""
    for view_layer in shot.scene.view_layers:
        name = view_layer.name
        combined, layer = picture.colour(f"{name}.Combined", "RGBA"), picture.layer(name)
        check_range(name, combined)
        for part in PARTS:
            check_range(f"{name}.{part}", picture.colour(f"{name}.{part}"))
        if shot.transparent or shot.row["world"] == "black":
            check_same(f"{name}: combined beside its parts", combined[..., :3], layer, SAME)
        if len(view_layer.lightgroups):
            groups = [picture.colour(f"{name}.Combined_{group.name}") for group in view_layer.lightgroups]
            check_same(f"{name}: light groups together", np.sum(groups, axis=0), layer, SAME)


def double_the_light(scene: "bpy.types.Scene") -> None:
    for data in bpy.data.lights:
        data.energy *= 2.0
    names = {"EMISSION": "Strength", "BACKGROUND": "Strength", "PRINCIPLED_VOLUME": "Emission Strength"}
    for tree in [scene.world.node_tree, *(material.node_tree for material in bpy.data.materials)]:
        for node in tree.nodes:
            if node.type in names:
                node.inputs[names[node.type]].default_value *= 2.0


def animation(shot: Shot) -> None:
    """Both frames are written, whatever the second one lacks."""
    scene, folder = shot.scene, shot.folder("animation")
    write_passes(scene)
    scene.render.filepath = f"{folder}/####"
    bpy.ops.render.render(animation=True)
    frames, suffixes = [scene.frame_start, scene.frame_end], shot.suffixes
    written = sorted(path.stem for path in folder.iterdir())
    assert written == sorted(f"{frame:04}{suffix}" for frame in frames for suffix in suffixes), written
    for name in written:
        picture = read_picture(folder / f"{name}.exr")
        check_range(name, picture.colour("ViewLayer.Combined", "RGBA"))
        missing = shot.row["volume"] == "sequence with a gap" and int(name[:4]) == frames[1]
        assert not (missing and shot.row["placement"] != "overlapping" and picture.layer().any())


def viewport(shot: Shot) -> None:
    """Every picture of Rendered shading, in a view that is the camera's: the last one is F12's layer.

    Without motion blur, which no viewport shows.
    """
    engine, scene = shot.package.mrpnn_addon.engine, shot.scene
    scene.render.use_motion_blur = False
    depsgraph = blender_scenes.depsgraph()
    description = shot.package.mrpnn_addon.scene.reader.read_view(depsgraph, view_3d())
    lens, part = scene.camera.data, engine.viewport.WHOLE
    if scene.render.use_border:
        render_settings = scene.render
        part = (
            render_settings.border_min_x,
            render_settings.border_min_y,
            render_settings.border_max_x,
            render_settings.border_max_y,
        )
    if lens.type == "PANO" or scene.render.pixel_aspect_x != scene.render.pixel_aspect_y:
        # A viewport shows no panorama, and its pixels are square.
        camera = shot.package.mrpnn_addon.objects.camera.read_camera(depsgraph)[0]
    else:
        camera = engine.viewport.viewport_camera(
            scene.camera.matrix_world.normalized().inverted(),
            scene.camera.calc_matrix_camera(depsgraph, x=SIZE[0], y=SIZE[1]),
            lens.type == "PERSP",
            SIZE,
            lens.clip_end,
            part,
        )
    objects = shot.package.mrpnn_addon.objects.camera
    blurred = objects.read_lens(scene.camera.evaluated_get(depsgraph), depsgraph)
    camera = replace(camera, exposure=objects.film_exposure(scene), lens=blurred)
    settings = scene.mrpnn.settings()
    shared = engine.preview.Prepared(shot.package.inference.RenderCache())
    # The second view finds what the first one has computed, and takes other steps.
    for number in (1, 2):
        preview = engine.preview.Preview(description, camera, settings, shared)
        while not preview.done:
            time.sleep(0.002)
        assert not preview.message, f"view {number}: {preview.message}"
        if not description.volumes:
            assert preview.picture is None
            continue
        picture = preview.picture[::-1]
        check_range(f"view {number}", picture)
        x0, y0, x1, y1 = (round(share * size) for share, size in zip(part, SIZE * 2))
        expected = shot.picture.layer()[SIZE[1] - y1 : SIZE[1] - y0, x0:x1]
        check_near(f"view {number}", picture[..., :3], expected, SHOWN)


def view_3d() -> "bpy.types.SpaceView3D":
    areas = (area for screen in bpy.data.screens for area in screen.areas)
    return next(area.spaces.active for area in areas if area.type == "VIEW_3D")


def render_volumes(shot: Shot) -> None:
    """The images and the files of Render Volumes are F12's layers."""
    path = shot.stage.folder / "layer.exr"
    bpy.ops.mrpnn.render(filepath=str(path))
    for suffix in shot.suffixes:
        pixels = image_pixels(bpy.data.images[f"MRPNN{suffix}"])
        check_range("the image", pixels)
        check_same("the file", read_picture(path, suffix).colour("ViewLayer.Combined", "RGBA"), pixels, SAME)
        check_same("the image", pixels[..., :3], shot.pictures[suffix].layer(), SAME)
        if shot.transparent:
            check_same("alpha", pixels[..., 3], shot.pictures[suffix].channels["ViewLayer.Combined.A"], SAME)


def composite(shot: Shot) -> None:
    """Composite over Cycles shows, over nothing, the layer itself, and leaves no trace when it is removed."""
    scene = shot.scene
    over_nothing = shot.row["surface"] == "none" and (shot.transparent or shot.row["world"] == "black")
    expected = shot.picture.layer() if over_nothing else None
    scene.render.use_multiview = False
    before = state()
    assert bpy.ops.mrpnn.composite() == {"FINISHED"}
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 1, False, "CPU"
    found = blender_scenes.rendered(scene, shot.stage.folder, transparent=shot.transparent)
    check_range("the composite", found)
    if expected is not None:
        check_same("over nothing", found[..., :3], expected, SAME)
    assert bpy.ops.mrpnn.composite_remove() == {"FINISHED"}
    assert state() == before


def state() -> dict[str, list[str]]:
    """Names of what the file holds."""
    kinds = ("objects", "volumes", "materials", "collections", "node_groups", "scenes", "worlds")
    return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}


def bake(shot: Shot) -> None:
    """Baked light along its own rays is the layer's multiple scattering; its removal leaves no trace."""
    before, folder = state(), shot.folder("light")
    if refuses(shot, lambda: bpy.ops.mrpnn.bake_light(folder=str(folder), directional=False)):
        return
    description = shot.package.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    lights = [shown for shown in bpy.data.objects if "mrpnn_light" in shown]
    assert len(lights) == len(description.volumes) == len(list(folder.glob("*.vdb")))
    assert all(shown.data.grids.load() for shown in lights)
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
    assert state() == before
    if description.volumes:
        check_baked(shot.package.inference, description)


def bake_animation(shot: Shot) -> None:
    """Bake Animation writes light for each frame that has volumes, and shows it; its removal leaves no trace."""
    before, scene, folder = state(), shot.scene, shot.folder("light")
    frames = range(scene.frame_start, scene.frame_end + 1)
    call = functools.partial(bpy.ops.mrpnn.bake_animation, folder=str(folder), directional=False)
    if refuses(shot, call):
        return
    assert list(folder.glob("*.vdb"))
    for frame in frames:
        scene.frame_set(frame)
        for shown in [shown for shown in bpy.data.objects if "mrpnn_light" in shown and not shown.hide_render]:
            assert shown.evaluated_get(blender_scenes.depsgraph()).data.grids.load(), f"{shown.name}, frame {frame}"
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
    assert state() == before


def live_light(shot: Shot) -> None:
    """Live Light shows the light of every volume by itself, and follows lights that move; its removal leaves no trace.

    Of the coarse light that comes at once; what it becomes when nothing moves is Bake Light's.
    """
    before, live, scene = state(), shot.package.mrpnn_addon.baking.live, shot.scene
    description = shot.package.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph(), goes_on=True)
    scene.mrpnn_live_light = True
    try:
        problem = until_shown(live, scene, len(description.volumes), set())
        if problem:
            assert REFUSAL in problem and is_dark(shot.row), problem
            return
        assert not is_dark(shot.row), "a scene without light is not refused"
        lights = [shown for shown in scene.objects if shown.type == "LIGHT"]
        for light in lights:
            light.rotation_euler.x += 0.5
            light.location.x += 0.1
        if lights and description.volumes:
            assert not until_shown(live, scene, len(description.volumes), shown_light())
    finally:
        scene.mrpnn_live_light = False
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
    assert state() == before


def shown_light() -> set[str]:
    """Files of the baked light that is shown, which Blender can read."""
    lights = [shown for shown in bpy.data.objects if "mrpnn_light" in shown]
    assert all(shown.data.grids.load() for shown in lights)
    return {shown.data.filepath for shown in lights}


def until_shown(live: ModuleType, scene: "bpy.types.Scene", count: int, former: set[str]) -> str:
    """Call the timer of Live Light until so many other files than the former are shown; gives its problem, or ""."""
    end = time.monotonic() + 300.0
    while len(shown_light() - former) < count or not count and "up to date" not in live.live_status(scene)[0]:
        assert time.monotonic() < end, live.live_status(scene)
        bpy.context.view_layer.update()
        live.tick()
        status, is_problem = live.live_status(scene)
        if is_problem:
            return status
        time.sleep(0.05)
    return ""


def check_baked(inference: ModuleType, description: object) -> None:
    """Without surfaces: what they throw back is baked together with what scatters once."""
    volumes, lights, view = description.volumes, description.lights, description.camera
    lit = inference.bake(volumes, lights, view, inference.Settings(directional=False))
    view = finer(view)
    # A bake's light is resolved for any camera.
    exact = inference.Settings(16)
    exact.optimizations -= {"level_of_detail"}
    expected = filtered(inference.render(volumes, lights, view, exact).multiple)
    dark = [(replace(volume, emission=None), replace(medium, albedo=np.zeros(3))) for volume, medium in volumes]
    glow = [
        (inference.Volume(np.ones(one.emission.shape[:3]), one.world_from_index, one.name, one.emission),
         inference.Medium(0.0)) for one in lit
    ]  # fmt: skip
    settings = inference.Settings(multiple=False)
    found = filtered(inference.render([*dark, *glow], [inference.Sun((0.0, 0.0, 1.0), 0.0)], view, settings).emission)
    check_range("the bake", found)
    if expected.max() > 1e-6:
        means = f"means {found.mean():.4g} and {expected.mean():.4g}"
        bias = abs(found.mean() / expected.mean() - 1.0)
        apart = np.sqrt(np.mean((found - expected) ** 2)) / expected.mean()
        assert bias <= BAKED_MEAN and apart <= BAKED, f"the bake differs by {apart:.3g} of the mean ({means})"


def finer(view: Any) -> Any:
    """A camera with FILTER x FILTER pixels for each one."""
    region = view.region and tuple(FILTER * edge for edge in view.region)
    return replace(view, resolution=tuple(FILTER * size for size in view.resolution), region=region)


def filtered(picture: np.ndarray) -> np.ndarray:
    """Means of FILTER x FILTER pixels of a picture (H, W, 3)."""
    height, width = picture.shape[0] // FILTER, picture.shape[1] // FILTER
    means: np.ndarray = picture.reshape(height, FILTER, width, FILTER, 3).mean(axis=(1, 3))
    return means


def command_render(shot: Shot) -> None:
    """`--command mrpnn render` writes F12's layers, with their parts, mattes and other passes, and deep samples."""
    path = shot.stage.folder / "command.exr"
    for view_layer in shot.scene.view_layers:
        view_layer.use_pass_cryptomatte_object = view_layer.use_pass_position = view_layer.use_pass_shadow = True
        view_layer.mrpnn.use_pass_median_depth = True
    # Blurred pictures have no deep samples.
    deep = [] if shot.row["camera"] in ("lens", "moving") else ["--deep"]
    (frame,) = run_command(shot, "render", *deep, "--output", str(path))["frames"]
    assert all(Path(file).exists() for file in frame["files"])
    for suffix in shot.suffixes:
        layer, expected = read_picture(path, suffix), shot.pictures[suffix]
        check_range("the file", layer.colour("ViewLayer.Combined", "RGBA"))
        brightest = max(expected.layer().max(), 1e-6)
        check_same("the file", layer.colour("ViewLayer.Combined"), expected.layer(), SAME)
        for name, part in zip(("Single", "Multiple", "Emission"), PARTS):
            apart = np.abs(layer.colour(f"ViewLayer.{name}") - expected.colour(f"ViewLayer.{part}")).max()
            assert apart <= SAME * brightest, f"{name} differs by {apart:.3g}"
        check_outputs(layer, expected)
        if deep:
            check_deep(path.with_stem(f"{path.stem}_deep{suffix}"), layer)


def check_outputs(layer: Picture, expected: Picture) -> None:
    """Mattes add up to the alpha, shadows are shares, and everything is what F12 has."""
    # Outside of a border, F12 has zeros where a file has what it holds of pixels without volumes.
    seen = layer.channels["ViewLayer.Alpha.A"] > 0.0
    for name in ("Position.X", "Position.Y", "Position.Z", "Median Depth.Z", "Shadow.R", "CryptoObject00.g"):
        found = layer.channels[f"ViewLayer.{name}"]
        assert np.isfinite(found).all(), f"{name} holds values that are not finite"
        check_same(name, found * seen, expected.channels[f"ViewLayer.{name}"] * seen, SAME)
    mattes = [layer.channels[f"ViewLayer.CryptoObject{n:02}.{letter}"] for n in range(3) for letter in "ga"]
    check_same("mattes beside alpha", np.sum(mattes, axis=0), layer.channels["ViewLayer.Alpha.A"], SAME)
    check_range("shadow", 1.0 - layer.channels["ViewLayer.Shadow.R"])


def check_deep(path: Path, layer: Picture) -> None:
    """Samples show, one behind the other, what the layer shows."""
    counts, samples = read_deep(path)
    colours = np.stack([samples[letter] for letter in "RGBA"], axis=-1).astype(np.float64)
    check_range("deep samples", colours)
    assert np.all(samples["ZBack"] >= samples["Z"]), "deep samples end before they begin"
    pixel = np.repeat(np.arange(counts.size), counts.ravel())
    number = np.arange(len(pixel)) - np.repeat(np.cumsum(counts.ravel()) - counts.ravel(), counts.ravel())
    flat = np.zeros((counts.size, 4))
    for n in range(int(counts.max(initial=0))):
        flat[pixel[number == n]] += (1.0 - flat[pixel[number == n], 3:]) * colours[number == n]
    check_same(
        "deep samples together", flat.reshape(*counts.shape, 4), layer.colour("ViewLayer.Combined", "RGBA"), SAME
    )


def command_bake(shot: Shot) -> None:
    """`--command mrpnn bake` writes light and a file that shows it."""
    folder = shot.folder("light")
    found = run_command(shot, "bake", "--folder", str(folder), "--save", str(folder / "lit.blend"), "--no-directions")
    assert (folder / "lit.blend").exists()
    files = [path for frame in found["frames"] for path in frame["files"].values()]
    assert all(Path(path).exists() for path in files)


def run_command(shot: Shot, *arguments: str) -> dict:
    """The command's results."""
    facts = shot.stage.folder / "facts.json"
    status = shot.package.operators.command.main([*arguments, "--json", str(facts)])
    found = json.loads(facts.read_text())
    assert status == 0, found["error"]
    return found


def flipbook(shot: Shot) -> None:
    """Light maps are there whatever the scene's own lights are, a frame without a volume is empty, and the operator and
    the command write the same.
    """
    scene, folder = shot.scene, shot.folder("flipbook")
    wanted, before = scene.mrpnn_flipbook, (scene.frame_current, scene.frame_subframe)
    wanted.columns, wanted.rows, wanted.size, wanted.padding, wanted.file_format = 2, 1, 48, 2, "EXR"
    wanted.view = "CAMERA"
    wanted.filepath = str(folder / "maps")
    try:
        bpy.ops.mrpnn.flipbook()
    except RuntimeError as error:
        panorama = scene.camera.data.type == "PANO"
        assert ("light maps need" if panorama else "no frame shows a volume") in str(error), error
        return
    assert scene.camera.data.type != "PANO", "light maps of a panorama"
    assert (scene.frame_current, scene.frame_subframe) == before
    facts = run_command(shot, "flipbook", "--output", str(folder / "command.exr"))
    assert (folder / "maps_motion.exr").exists() == (folder / "command_motion.exr").exists()
    for name in ["A", "B"] + ["motion"] * (folder / "maps_motion.exr").exists():
        picture, command = (
            np.stack([read_picture(folder / f"{base}_{name}.exr").channels[letter] for letter in "RGBA"], axis=-1)
            for base in ("maps", "command")
        )
        check_range(name, picture)
        # A domain's cache leaves out velocities where there is hardly any smoke.
        check_same(f"the command's {name}", command, picture, 0.05 if name == "motion" else SAME)
    missing = shot.row["volume"] == "sequence with a gap" and shot.row["placement"] != "overlapping"
    assert facts["frames"][1]["empty"] or not missing


def compare(shot: Shot) -> None:
    """Compare with Cycles comes to its report."""
    folder = shot.folder("comparison")
    options = dict(samples=1, ladder=0, denoised=False, bounces=4, scale=100, folder=str(folder))
    try:
        if refuses(shot, lambda: bpy.ops.mrpnn.compare(**options)):
            return
    except AssertionError as error:
        if CYCLES_IS_BROKEN and BROKEN_CYCLES in str(error):
            return
        raise
    assert list(folder.rglob("*.html"))


def check_alpha(shot: Shot) -> None:
    """Alpha is Cycles', in a scene whose surfaces cut out of the volumes what they hide, as in a layer."""
    if CYCLES_IS_BROKEN:
        return
    scene, inference = shot.scene, shot.package.inference
    scene.render.use_multiview = scene.render.use_border = False
    description = shot.package.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    layer = inference.render(
        description.volumes, [], description.camera, inference.Settings(multiple=False), surfaces=description.surfaces
    )
    for surface in shot.stage.surfaces:
        surface.is_holdout = True
    for light in [shown for shown in scene.objects if shown.type == "LIGHT"]:
        bpy.data.objects.remove(light)
    scene.world = bpy.data.worlds.new("Black")
    scene.world.color = 0.0, 0.0, 0.0
    while len(scene.view_layers) > 1:
        scene.view_layers.remove(scene.view_layers[-1])
    blender_scenes.set_up_cycles(scene, CYCLES_SAMPLES)
    # Through the middle of each pixel, as the layer's rays.
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    expected = blender_scenes.rendered(scene, shot.stage.folder)[..., 3]
    apart = np.abs(layer.alpha - expected).mean()
    means = f"means {layer.alpha.mean():.4g} and {expected.mean():.4g}"
    assert apart <= CYCLES_MEAN, f"alpha differs from Cycles' by {apart:.3g} ({means})"


Door = Callable[[Shot], None]
DOORS: dict[str, Door] = {
    "f12": f12,
    "animation": animation,
    "viewport": viewport,
    "render volumes": render_volumes,
    "composite": composite,
    "bake": bake,
    "bake animation": bake_animation,
    "live light": live_light,
    "command render": command_render,
    "command bake": command_bake,
    "flipbook": flipbook,
    "compare": compare,
    "cycles' alpha": check_alpha,
}
