"""Pages looked at in headless Chromium: console messages, images, the table of contents, the width on a phone."""

import html
import json
import re
import shutil
import subprocess

import pytest

BINARY = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
needs_chromium = pytest.mark.skipif(BINARY is None, reason="no Chromium found to look at the page with")

OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--v=0",
    "--virtual-time-budget=20000",
    "--window-size=1000,1000",
    "--dump-dom",
]

#: runs beside the page, which is in a frame as wide as a phone
SCRIPT = """
const frame = document.getElementById("page");
frame.onload = () => {
  const page = frame.contentDocument;
  const found = {
    client: page.documentElement.clientWidth,
    scroll: page.documentElement.scrollWidth,
    images: [...page.images].map(image => [image.alt, image.naturalWidth]),
    links: [...page.querySelectorAll("nav a")].map(link => link.getAttribute("href")),
    missing: [...page.querySelectorAll("nav a")].filter(link => !page.querySelector(link.getAttribute("href"))).length,
    fetched: frame.contentWindow.performance.getEntriesByType("resource").map(entry => entry.name).filter(name => !name.startsWith("data:")),
  };
  document.getElementById("found").textContent = JSON.stringify(found);
};
frame.srcdoc = document.getElementById("source").content.textContent;
"""


def looked_at(page, folder, width=390):
    """What Chromium sees of a page (HTML) in a frame of that width, and what the console said."""
    path = folder / "frame.html"
    path.write_text(
        f'<!DOCTYPE html><html><head><meta charset="utf-8"></head><body><iframe id="page" width="{width}" height="844" style="border: 0"></iframe>'
        f'<pre id="found"></pre><template id="source">{html.escape(page)}</template><script>{SCRIPT}</script></body></html>',
        encoding="utf-8",
    )
    profile = folder / "profile"
    profile.mkdir()
    run = subprocess.run(
        [BINARY, *OPTIONS, f"--user-data-dir={profile}", path.as_uri()], capture_output=True, text=True, timeout=120
    )
    text = re.search(r'<pre id="found">(.*?)</pre>', run.stdout, re.DOTALL)
    assert text is not None, run.stderr
    assert text[1], run.stderr
    found = json.loads(html.unescape(text[1]))
    found["console"] = [line for line in run.stderr.splitlines() if "CONSOLE" in line]
    return found


def well_made(found, images):
    """What every page must be: quiet, complete, with alternatives, not wider than the phone."""
    assert found["console"] == []
    assert found["fetched"] == []
    assert len(found["images"]) == images
    assert all(alternative and width > 0 for alternative, width in found["images"])
    assert found["links"]
    assert found["missing"] == 0
    assert found["scroll"] <= found["client"]
