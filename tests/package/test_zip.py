# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip that users install: its contents, and that the installed extension renders by itself."""

import hashlib
import shutil
import subprocess
import sys
import sysconfig
import textwrap
import tomllib
import zipfile
from pathlib import Path

import pytest

import build_extension
from packages.kernels import MODULE, wheel_name
from tests.support.paths import ROOT
from tests.support.render_with_zip import install

# What the bpy module itself imports; everything else of this environment stays out of sight.
BLENDER_NEEDS = (
    "bpy",
    "numpy",
    "numpy.libs",
    "requests",
    "urllib3",
    "idna",
    "certifi",
    "charset_normalizer",
    "zstandard",
    "Cython",
)


@pytest.mark.slow
def test_every_platform_gets_its_own_wheels_and_only_the_extensions_files(zips):
    facts = build_extension.manifest()
    names = {f"{facts['id']}-{facts['version']}-{platform.replace('-', '_')}" for platform in facts["platforms"]}
    names |= {f"{name}-any_python" for name in names if "linux" in name}
    assert {path.stem for path in zips} == names and len(names) == 8
    for path in zips:
        assert path.stat().st_size <= 40e6
        archive = zipfile.ZipFile(path)
        names = archive.namelist()
        assert {Path(name).parts[0] for name in names} == {
            "blender_manifest.toml",
            "__init__.py",
            "LICENSE",
            "mrpnn_addon",
            "operators",
            "panels",
            "inference",
            "evaluation",
            "docs",
            "wheels",
        }
        (platform,) = [name for name in facts["platforms"] if name.replace("-", "_") in path.name]
        wheels = sorted(name for name in names if name.startswith("wheels/"))
        kernels, *runtimes = wheels
        assert kernels == f"wheels/{wheel_name(platform)}"
        if "any_python" in path.name or platform == "macos-x64":
            assert not runtimes
        else:
            assert [Path(name).name.split("-")[::2][:2] for name in runtimes] == [
                ["onnxruntime", "cp311"],
                ["onnxruntime", "cp313"],
            ]
        # Blender reads the wheels and the Pythons that fit from what the manifest says.
        said = tomllib.loads(archive.read("blender_manifest.toml").decode())["build"]["generated"]
        assert sorted(name.removeprefix("./") for name in said["wheels"]) == wheels
        assert said["platforms"] == [platform]
        # Libraries come in wheels alone.
        assert not [name for name in names if name.endswith((".pyc", ".pt", ".so", ".dll", ".dylib", ".c"))]
        # Python reads the structures that it shares with them from these.
        headers = {"inference/kernels/fields.h", "inference/kernels/kernels.h"}
        assert {name for name in names if name.endswith(".h")} == headers
        assert "inference/weights/mrpnn.onnx" in names
        assert {"inference/weights/uncertainty/mrpnn.onnx", "inference/weights/uncertainty/mrpnn.sha256"} <= set(names)


@pytest.mark.slow
def test_the_zips_and_wheels_are_the_same_to_the_byte_when_built_again(zips):
    def digests():
        return [hashlib.sha256(path.read_bytes()).hexdigest() for path in [*zips, *kernels]]

    kernels = sorted(build_extension.WHEELS.glob(f"{MODULE}-*.whl"))
    assert len(kernels) == 6
    before = digests()
    (ROOT / "blender_manifest.toml").touch()
    assert build_extension.build() == zips and digests() == before


def test_a_wheel_with_another_checksum_is_refused(tmp_path):
    for name in ("build_extension.py", "blender_manifest.toml", "requirements-wheels.txt"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / "packages", tmp_path / "packages")
    for name in build_extension.manifest()["wheels"]:
        wheel = tmp_path / name
        wheel.parent.mkdir(parents=True, exist_ok=True)
        wheel.write_bytes(b"not the wheel")
    built = subprocess.run([sys.executable, "build_extension.py"], cwd=tmp_path, capture_output=True, text=True)
    assert built.returncode != 0
    assert "is not the file that requirements-wheels.txt lists" in built.stderr
    assert not list(tmp_path.glob("build/*.zip"))


def test_a_tag_that_is_not_the_version_is_refused():
    version = build_extension.manifest()["version"]
    build_extension.check_tag(f"v{version}")
    for tag in (version, f"v{version}.1", "v999.0.0"):
        with pytest.raises(SystemExit, match=f"version {version}"):
            build_extension.check_tag(tag)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="takes the Linux zip")
def test_the_zips_code_renders_with_its_wheels_alone(zips):
    """What the release's workflow does on each platform."""
    program = ROOT / "tests" / "support" / "render_with_zip.py"
    run = subprocess.run([sys.executable, program, ROOT], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0 and "largest difference" in run.stdout, run.stdout + run.stderr


LOADED = "from inference.kernels.library import load_kernels; print(load_kernels().path)"


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="takes the Linux zip")
def test_kernels_of_another_version_are_refused_with_what_to_do(linux_zip, tmp_path):
    """Blender installs one mrpnn_kernels for all extensions: that of the highest version."""
    install(linux_zip, tmp_path)
    (library,) = (tmp_path / "site" / "mrpnn_kernels").glob("*.so")

    def loads():
        paths = [tmp_path / "extension", tmp_path / "site", sysconfig.get_path("purelib")]
        return subprocess.run(
            [sys.executable, "-S", "-c", LOADED],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env={"PYTHONPATH": ":".join(map(str, paths))},
        )

    assert loads().stdout.strip() == str(library)
    remedies = {1: "restart Blender", 9999: "remove one of the two in Preferences > Get Extensions"}
    for number, remedy in remedies.items():
        source = tmp_path / "other.c"
        source.write_text(f"long long mrpnn_interface(void) {{ return {number}; }}\n")
        library.unlink()
        subprocess.run([sys.executable, "-m", "ziglang", "cc", "-shared", source, "-o", library], check=True)
        said = loads().stderr
        assert f"has interface {number} instead of" in said and remedy in said
    shutil.rmtree(library.parent)
    assert "is missing. Uninstall MRPNN Volumes, restart Blender" in loads().stderr


INSTALLED_RENDER = """
    import importlib.util, pathlib, sys

    resources, package = pathlib.Path(sys.argv[1]), sys.argv[2]
    assert importlib.util.find_spec("onnxruntime") is None, "the test must not see another onnxruntime"

    import bpy
    import numpy as np

    result = bpy.ops.extensions.package_install_files(
        filepath=package, repo="user_default", enable_on_install=True, overwrite=True)
    assert result == {"FINISHED"}, result
    assert "bl_ext.user_default.mrpnn" in bpy.context.preferences.addons

    # A fog ball under the sun, seen from above.
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    openvdb = importlib.import_module("bl_ext.user_default.mrpnn.mrpnn_addon.vdb.openvdb_module").load_openvdb()
    grid = openvdb.FloatGrid()
    axis = np.linspace(-1, 1, 32)
    radius = np.sqrt(sum(np.meshgrid(axis**2, axis**2, axis**2)))
    grid.copyFromArray((radius < 0.8).astype(np.float32))
    grid.name = "density"
    grid.transform = openvdb.createLinearTransform(1 / 16)
    openvdb.write(str(resources / "ball.vdb"), grids=[grid])

    scene = bpy.context.scene
    volume = bpy.data.volumes.new("ball")
    volume.filepath = str(resources / "ball.vdb")
    material = bpy.data.materials.new("fog")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeVolumePrincipled")
    shader.inputs["Density"].default_value = 5.0
    tree.links.new(shader.outputs["Volume"], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    volume.materials.append(material)
    ball = bpy.data.objects.new("ball", volume)
    ball.location = (-1, -1, -1)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    lens = bpy.data.cameras.new("camera")
    lens.type, lens.ortho_scale = "ORTHO", 3.0
    camera = bpy.data.objects.new("camera", lens)
    camera.location = (0, 0, 5)
    for item in (ball, sun, camera):
        scene.collection.objects.link(item)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.render.resolution_percentage = 100

    assert "onnxruntime" not in sys.modules, "registration must not load the network's runtime"
    layers = resources / "layers.exr"
    assert bpy.ops.mrpnn.render(filepath=str(layers)) == {"FINISHED"}
    assert layers.stat().st_size > 1000
    import onnxruntime
    assert resources in pathlib.Path(onnxruntime.__file__).resolve().parents, onnxruntime.__file__

    (image,) = [image for image in bpy.data.images if image.size[0] == 16]
    pixels = np.empty(16 * 16 * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(16, 16, 4)
    # Through the ball's centre: a chord of 1.6 ball radii at density 5.
    assert abs(pixels[7:9, 7:9, 3].mean() - (1 - np.exp(-5 * 1.6))) < 1e-3
    assert pixels[7:9, 7:9, :3].min() > 0 and pixels[0, 0, 3] == 0

    bpy.ops.preferences.addon_disable(module="bl_ext.user_default.mrpnn")
    assert not hasattr(bpy.types, "MRPNN_OT_render"), "disabling must unregister"
    # Enabled again, so that the process ends as a user's script does; Blender must survive that too.
    bpy.ops.preferences.addon_enable(module="bl_ext.user_default.mrpnn")
    assert hasattr(bpy.types, "MRPNN_OT_render")
    print("installed extension rendered")
"""


@pytest.mark.blender
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="installs the Linux zip")
def test_installed_extension_renders_with_its_own_wheels(linux_zip, tmp_path):
    site = tmp_path / "site"
    site.mkdir()
    for name in BLENDER_NEEDS:
        source = Path(sysconfig.get_path("purelib")) / name
        if source.exists():
            (site / name).symlink_to(source)
    resources = tmp_path / "resources"
    resources.mkdir()
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(INSTALLED_RENDER))
    # -S: without this environment's own site-packages.
    run = subprocess.run(
        [sys.executable, "-S", script, resources, linux_zip],
        capture_output=True,
        text=True,
        timeout=300,
        env={"PATH": "", "PYTHONPATH": str(site), "BLENDER_USER_RESOURCES": str(resources), "HOME": str(tmp_path)},
    )
    assert run.returncode == 0 and "installed extension rendered" in run.stdout, run.stdout + run.stderr
