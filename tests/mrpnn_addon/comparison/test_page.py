# SPDX-License-Identifier: GPL-3.0-or-later
"""The comparison's page in a real browser, as a single file."""

import importlib
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from tests.support import blender_scenes as make

BROWSER = shutil.which("chromium") or shutil.which("chromium-headless-shell")


@pytest.fixture(scope="module")
def report(addon, tmp_path_factory):
    """The folder of a comparison of a small cloud, and its figures."""
    folder = tmp_path_factory.mktemp("report")
    scene = make.empty_scene()
    make.cloud_scene(scene, folder)
    scene.name = "Clouds <over> & sea"
    scene.camera.location.z = 4.0
    scene.mrpnn.depth_samples = 2
    run = importlib.import_module("mrpnn.mrpnn_addon.comparison.run")
    made = run.ComparisonRun(
        make.bpy.context,
        scene.mrpnn.settings(),
        run.Options(samples=16, ladder=4, scale=50, depths=(1,), folder=str(folder / "out")),
    )
    made.wait()
    comparison = made.result()
    made.write(comparison)
    return folder / "out", comparison


def in_browser(page, script, folder):
    """What a script returns once the page has loaded, and the browser's console."""
    copy = folder / "copy.html"
    said = (
        "<script>addEventListener('load', () => { const out = document.createElement('pre'); out.id = 'said';\n"
        f"out.textContent = JSON.stringify((() => {{ {script} }})()); document.body.append(out);\n"
        "});</script></body>"
    )
    copy.write_text(page.replace("</body>", said), encoding="utf-8")
    run = subprocess.run(
        [
            BROWSER,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--enable-logging=stderr",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder / 'profile'}",
            "--dump-dom",
            copy.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=180,
    )
    found = re.search(r'<pre id="said">(.*?)</pre>', run.stdout, re.DOTALL)
    assert found, run.stderr[-2000:]
    console = [line for line in run.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(found[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")), console


@pytest.mark.skipif(BROWSER is None, reason="there is no chromium; .ci/run installs it")
def test_the_page_shows_pictures_chart_and_slider_in_a_browser(report, tmp_path):
    folder, comparison = report
    # A copy elsewhere: the page is self-contained.
    said, console = in_browser(
        (folder / "report.html").read_text(encoding="utf-8"),
        """
        const at = (id) => document.getElementById(id);
        const shown = () => getComputedStyle(at("left")).clipPath;
        const before = shown();
        at("place").value = 80; at("place").dispatchEvent(new Event("input"));
        const first = at("right").src;
        const options = at("right-choice").options;
        at("right-choice").value = options[options.length - 1].value;
        at("right-choice").dispatchEvent(new Event("change"));
        const box = document.querySelector("svg").getBoundingClientRect();
        const dots = [...document.querySelectorAll("svg .point circle")].map(dot => dot.getBoundingClientRect());
        return {title: document.title, sizes: [...document.images].map(i => [i.naturalWidth, i.naturalHeight]),
                before, after: shown(), changed: at("right").src !== first, choices: options.length,
                loaded: performance.getEntriesByType("resource").filter(r => !r.name.startsWith("data:")).length,
                dots: dots.length, inside: dots.every(d => d.left > box.left && d.right < box.right && d.top > box.top
                                                           && d.bottom < box.bottom), chart: box.width * box.height};
        """,
        tmp_path,
    )
    assert console == [] and said["loaded"] == 0
    assert said["title"] == "Error against run time: Clouds <over> & sea, frame 1"
    assert said["sizes"] == [[32, 32]] * 3
    # The boundary moved from the middle to four fifths.
    assert "50%" in said["before"] and "20%" in said["after"]
    # The compared layer, one more, two baselines, the reference, two sample counts with and without denoising.
    assert said["changed"] and said["choices"] == 9
    drawn = sum(rung.error > 0.0 for rung in comparison.rungs)
    assert said["dots"] == drawn and said["inside"] and said["chart"] > 1e5


def test_the_chart_is_well_formed_and_has_logarithmic_axes(report):
    chart = importlib.import_module("mrpnn.mrpnn_addon.comparison.chart")
    _, comparison = report
    made = chart.make_chart(comparison.rungs)
    (x1, y1), (x2, y2), (x3, y3) = (made.place(s, e) for s, e in ((0.1, 0.1), (0.2, 0.2), (0.4, 0.4)))
    assert x2 - x1 == pytest.approx(x3 - x2) and y2 - y1 == pytest.approx(y3 - y2)
    root = ElementTree.fromstring(chart.svg(made))
    assert len(list(root.iter("g"))) == sum(len(found) for found in made.series.values())


def test_csv_and_json_hold_the_figures_of_the_page(report):
    folder, comparison = report
    rows = (folder / "figures.csv").read_text().splitlines()
    figures = json.loads((folder / "figures.json").read_text())
    assert len(rows) - 1 == len(comparison.rungs) == len(figures["rungs"]) == 8
    assert rows[0].startswith("method,samples,seconds")
    first = dict(zip(rows[0].split(","), rows[1].split(",")))
    assert float(first["bias"]) == figures["bias"]["value"] == comparison.bias.value
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert f"{comparison.judged.rmse.value:.4f}" in text and "1024 bounces" in text


def test_pictures_keep_their_colours(report):
    import io

    from PIL import Image

    pictures = importlib.import_module("mrpnn.mrpnn_addon.comparison.pictures")
    reports = importlib.import_module("mrpnn.mrpnn_addon.comparison.report")
    layer = np.ones((2, 3, 4), np.float32)
    layer[0, 0, :3], layer[1, 2, :3] = 2.0, 0.0
    error = reports.signed_error(layer, np.ones_like(layer))
    shown = np.asarray(Image.open(io.BytesIO(pictures.display_png(error))).convert("RGB")) / 255
    # Too bright is red, too dark is blue, right is white; the first row is the upper one.
    assert shown[0, 0] == pytest.approx(reports.TOO_BRIGHT, abs=0.01)
    assert shown[1, 2] == pytest.approx(reports.TOO_DARK, abs=0.01)
    assert shown[0, 1] == pytest.approx([1, 1, 1], abs=0.01)


def test_the_chart_is_an_image_in_blender(report):
    _, comparison = report
    image = make.bpy.data.images["MRPNN chart"]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(image.size[1], image.size[0], 4)[::-1]
    chart = importlib.import_module("mrpnn.mrpnn_addon.comparison.chart")
    made = chart.make_chart(comparison.rungs, comparison.clock)
    last = list(made.series.values())[-1][-1]
    x, y = made.point(last)
    assert pixels[round(y), round(x), :3] == pytest.approx(
        importlib.import_module("mrpnn.mrpnn_addon.comparison.chart_image")._linear(made.colour(last.method)), abs=0.02
    )
    # Words on the axes.
    assert (pixels[chart.FRAME[3] + 4 :, :, :3].max(axis=-1) < 0.3).sum() > 50
