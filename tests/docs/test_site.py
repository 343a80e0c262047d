# SPDX-License-Identifier: GPL-3.0-or-later
"""The site of the docs: every page is in it and can be found, and nothing comes from another server."""

import json
import os
import re
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

pytest.importorskip("mkdocs")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    run = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    )
    assert run.returncode == 0 and "WARNING" not in run.stderr, run.stderr
    # Pages that no menu leads to are told, and do not fail.
    assert "not included in the" not in run.stderr, run.stderr
    return folder


@pytest.mark.slow
def test_every_page_is_there_and_in_the_search(site):
    wanted = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")}
    assert len(wanted) > 30 and [page for page in wanted if not (site / page).exists()] == []
    index = json.loads((site / "search" / "search_index.json").read_text())
    assert {entry["location"].partition("#")[0] for entry in index["docs"]} == {page.as_posix() for page in wanted}


@pytest.mark.slow
def test_no_page_loads_from_another_server(site):
    for page in site.rglob("*.html"):
        loaded = re.findall(r"<(?:script|img|iframe|link|source)[^>]*(?:src|href)=\"?([^\"\s>]+)", page.read_text())
        assert loaded and [address for address in loaded if re.match(r"(https?:)?//", address)] == [], page
    for style in site.rglob("*.css"):
        assert not re.search(r"(@import\s+|url\()[\"']?(https?:)?//", style.read_text()), style


@pytest.mark.slow
def test_links_and_pictures_lead_somewhere(site):
    for page in site.rglob("*.html"):
        if page.name == "404.html":
            continue
        for address in re.findall(r"(?:src|href)=\"?([^\"\s>#]+)", page.read_text()):
            if not re.match(r"[a-z]+:", address):
                assert (page.parent / address).exists(), f"{page.relative_to(site)}: {address}"
