# SPDX-License-Identifier: GPL-3.0-or-later
"""The docs' site in a real browser: pictures load, the search finds, and nothing is asked of another server."""

import http.server
import json
import os
import queue
import shutil
import subprocess
import sys
import threading

import pytest

from tests.support.paths import ROOT

pytest.importorskip("mkdocs")
BROWSER = shutil.which("chromium") or shutil.which("chromium-headless-shell")
pytestmark = [
    pytest.mark.slow(seconds=40),
    pytest.mark.skipif(BROWSER is None, reason="there is no chromium; .ci/run installs it"),
]
# Whatever else a page asks for is blocked by the browser, which tells the page so.
POLICY = "default-src 'self' 'unsafe-inline' data: blob:"
SECONDS = 60

# Each page says what it found and goes on to the next; the last one searches.
SCRIPT = """
<script>
const pages = PAGES, words = WORDS, asked = [], wait = ms => new Promise(done => setTimeout(done, ms));
addEventListener("securitypolicyviolation", event => asked.push(event.blockedURI));
const errors = []; addEventListener("error", event => errors.push(event.message ?? String(event.target.src)), true);
async function searched(word) {
  const field = document.querySelector("input.md-search__input");
  field.focus(); field.value = word;
  for (const kind of ["input", "change", "keyup"]) field.dispatchEvent(new Event(kind, {bubbles: true}));
  for (let tries = 0; tries < 200; tries++) {
    const all = [...document.querySelectorAll(".md-search-result__item a.md-search-result__link")];
    // Links tell their page what to highlight: those of an earlier word are still there at first.
    const found = all.filter(link => new URL(link.href).searchParams.get("h")?.includes(word.split(" ")[0]));
    if (found.length) return found.slice(0, 5).map(link => new URL(link.href).pathname);
    await wait(100);
  }
  return [];
}
addEventListener("load", async () => {
  const here = location.pathname, next = pages[pages.indexOf(here) + 1], found = {};
  if (!next) for (const word of words) found[word] = await searched(word);
  await wait(100);
  const images = [...document.images].filter(image => !image.naturalWidth).map(image => image.src);
  await fetch("/said", {method: "POST", body: JSON.stringify({here, images, asked, errors, found,
    pictures: document.images.length, wide: document.documentElement.scrollWidth > innerWidth, last: !next})});
  if (next) location = next;
});
</script>
"""


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serves the site with the script in each page; what pages say goes into `server.said`."""

    def do_POST(self):
        self.server.said.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def do_GET(self):
        if not self.path.partition("?")[0].endswith(".html"):
            return super().do_GET()
        with open(self.translate_path(self.path), "rb") as page:
            content = page.read().replace(b"<head>", b"<head>" + self.server.script.encode(), 1)
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", POLICY)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What each page of the site said, by its path; that of the last one has what the search found."""
    site = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", site]
    subprocess.run(command, cwd=ROOT, check=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    pages = [
        "/" + path.relative_to(site).as_posix() for path in sorted(site.rglob("*.html")) if path.name != "404.html"
    ]

    def handler(*arguments):
        return Handler(*arguments, directory=site)

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.said = queue.Queue()
        server.script = SCRIPT.replace("PAGES", json.dumps(pages)).replace("WORDS", json.dumps(list(SOUGHT)))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        profile = tmp_path_factory.mktemp("profile")
        browser = subprocess.Popen(
            [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0",
             "--disable-background-networking", "--window-size=1280,900", f"--user-data-dir={profile}",
             f"http://127.0.0.1:{server.server_port}{pages[0]}"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            answers, last = {}, False
            while not last:
                answer = server.said.get(timeout=SECONDS)
                answers[answer["here"]], last = answer, answer["last"]
        finally:
            browser.kill()
            browser.wait()
            server.shutdown()
    assert set(answers) == set(pages) and len(pages) > 30
    return answers


#: Words that a reader looks for, and the page that must be among the first five.
SOUGHT = {
    "flipbook": "/use/six-way.html",
    "render farm": "/use/farm.html",
    "glass": "/use/baked-light.html",
    "accuracy": "/trust/accuracy.html",
}


def test_every_picture_is_shown(said):
    assert {page: answer["images"] for page, answer in said.items() if answer["images"]} == {}
    assert sum(answer["pictures"] for answer in said.values()) > 100


def test_nothing_is_asked_of_another_server(said):
    assert {page: answer["asked"] for page, answer in said.items() if answer["asked"]} == {}
    assert {page: answer["errors"] for page, answer in said.items() if answer["errors"]} == {}


def test_no_page_is_wider_than_the_window(said):
    assert [page for page, answer in said.items() if answer["wide"]] == []


def test_the_search_finds(said):
    (found,) = (answer["found"] for answer in said.values() if answer["last"])
    assert {word: pages for word, pages in found.items() if SOUGHT[word] not in pages} == {}
