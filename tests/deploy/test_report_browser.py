"""The report in a real browser: it draws, holds every section, and asks the network for nothing."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deploy.mission import load
from deploy.session import run_mission

pytestmark = pytest.mark.browser

MISSION = Path(__file__).resolve().parents[2] / "mission_configs" / "lab.yaml"
SECTIONS = ["Map", "Vehicles", "Plans", "Loop", "Planned and actual", "Energy", "Altitude and distances", "Events"]
FETCHING = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href"}
"""Attributes for which a browser may go to the network."""


def chromium(*options: str, profile: Path) -> str:
    """Runs headless Chromium, cut off from the network, and returns what it printed."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.fail("chromium is missing; install it: apt-get install chromium")
    command = [
        program, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={profile}", *options,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


class Page(HTMLParser):
    """The headings of a page, what it would fetch, its scripts and its styles."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.headings: list[str] = []
        self.fetched: list[str] = []
        self.tags: list[str] = []
        self._inside = ""
        self.styles = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self._inside = tag
        self.fetched += [value for name, value in attrs if name in FETCHING and value]
        self.styles += "".join(value for name, value in attrs if name == "style" and value)

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside == "h2":
            self.headings.append(data.strip())
        if self._inside == "style":
            self.styles += data


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    run_mission(load(MISSION), out=folder)
    return folder / "report.html"


def test_every_section_is_there_and_nothing_is_fetched(report, tmp_path):
    page = Page(chromium("--dump-dom", report.as_uri(), profile=tmp_path))
    assert [h for h in page.headings if h != "Safety violations"] == SECTIONS
    assert page.tags.count("svg") == 4
    assert not {"script", "link", "iframe", "img", "object", "embed"} & set(page.tags)
    outside = [url for url in page.fetched if not url.startswith(("#", "data:"))]  # data: the map's image, inlined
    assert outside == [], "the report must be one file that needs no network"
    assert re.findall(r"@import|url\((?!['\"]?(?:#|data:))", page.styles) == []


@pytest.mark.parametrize("width", [1280, 500])
def test_it_draws(report, tmp_path, width):
    height = 3000
    picture = tmp_path / "page.png"
    chromium(
        f"--screenshot={picture}", f"--window-size={width},{height}", report.as_uri(), profile=tmp_path / "profile"
    )
    with Image.open(picture) as image:
        assert image.size == (width, height)
        pixels = np.asarray(image.convert("RGB")).astype(int)
    ground = pixels[2, 2]
    drawn = np.abs(pixels - ground).sum(axis=2) > 12
    assert drawn[:, 10:-10].mean() > 0.3, "the page is nearly blank"
    assert (~drawn[:, : 5 if width < 900 else 20]).all(), "the page is wider than the window"
    coloured = pixels.max(axis=2) - pixels.min(axis=2) > 90
    assert coloured.mean() > 0.002, "no chart has any colour"
