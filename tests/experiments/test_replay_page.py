"""The replay page in a real browser: it plays, selects, colours, and lets nothing in or out."""

from __future__ import annotations

import dataclasses
import io

import numpy as np
import pytest
from PIL import Image
from PIL.ImageColor import getrgb as rgb

from behaviors.labels import BEHAVIORS, COLORS, UNKNOWN_COLOR
from experiments.replay.page import MODES, RAMP, write_page

SIZES = {"wide": (1280, 800), "narrow": (390, 844)}
CONTROLS = {
    "theme", "help", "graph", "paths", "names", "zoom-in", "zoom-out", "fit", "stage", "previous",
    "play", "next", "scrub", "rate",
}  # fmt: skip


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene()


@pytest.fixture(scope="module")
def path(scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("replay") / "replay.html"
    write_page(scene, out, "true")
    return out


@pytest.fixture
def open_page(browser, path):
    """Opens the page; when the test is over, nothing may have gone wrong or been fetched."""
    pages, wrong, requests = [], [], []

    def open_it(width=1280, height=800, scheme="light", link="", file=path):
        page = browser.new_page(
            viewport={"width": width, "height": height},
            color_scheme=scheme,
            reduced_motion="reduce",
        )
        page.on("console", lambda m: wrong.append(m.text) if m.type != "log" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda r: requests.append(r.url))
        page.goto(file.as_uri() + link)
        page.wait_for_selector("body[data-ready]", timeout=20_000)
        pages.append(page)
        return page

    yield open_it
    for page in pages:
        page.close()
    assert wrong == []
    assert [url for url in requests if not url.startswith(("file:", "data:"))] == []
    assert len([url for url in requests if url.startswith("file:")]) == len(pages)


def state(page):
    return page.evaluate("replay.state()")


def until(page, condition):
    """Wait for something; the page's own policy forbids to evaluate strings in it."""
    for _ in range(200):
        if condition():
            return
        page.wait_for_timeout(25)
    raise AssertionError("waited for 5 s")


def drawn(page):
    """Wait until what was changed has been drawn."""
    page.evaluate("() => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r)))")


def test_it_plays_and_pauses(open_page):
    page = open_page()
    assert state(page)["playing"] is False
    page.keyboard.press("Space")
    until(page, lambda: state(page)["time"] > 0.2)
    assert page.get_by_role("button", name="Pause").is_visible()
    page.keyboard.press("Space")
    assert state(page)["playing"] is False


def test_it_scrubs_with_keys_and_slider(open_page):
    page = open_page()
    page.evaluate("replay.seek(0.0)")
    page.keyboard.press("Shift+ArrowRight")
    assert state(page)["time"] == pytest.approx(10.0)
    page.keyboard.press(",")
    assert state(page)["time"] == pytest.approx(9.9, abs=0.02)
    page.locator("#scrub").fill("4.5")
    assert state(page)["time"] == pytest.approx(4.5)
    until(page, lambda: page.locator("#clock").inner_text().startswith("4.5"))


def test_what_is_packed_is_unpacked(open_page, scene):
    page = open_page()
    page.evaluate("replay.seek(7.0)")
    shown = {a["index"]: a["at"] for a in page.evaluate("replay.agents()")}
    step = int(np.searchsorted(scene.tracks.time_s, 7.0 - 1e-6))
    present = np.flatnonzero(scene.tracks.valid[:, step])
    assert sorted(shown) == present.tolist()
    for row in present:
        assert shown[row] == pytest.approx(scene.tracks.xy[row, step], abs=0.02)


def test_futures_are_unpacked_too(open_page, scene):
    page = open_page()
    page.evaluate("replay.seek(7.0)")
    made = scene.futures
    for row in (0, 3):
        shown = page.evaluate(f"replay.futures({row})")
        now = np.abs(made.time_s - shown[0]["time"]) < 1e-3
        mine = np.flatnonzero((made.agent == row) & now)
        assert [f["probability"] for f in shown] == pytest.approx([0.75, 0.25], abs=0.01)
        for future, m in zip(shown, mine, strict=True):
            assert np.abs(np.array(future["places"]) - made.xy[m]).max() < 0.06


def test_a_click_selects_and_a_hostile_name_stays_text(open_page, scene):
    page = open_page()
    page.evaluate("replay.seek(5.0)")
    first = next(a for a in page.evaluate("replay.agents()") if a["index"] == 0)
    box = page.locator("#stage").bounding_box()
    page.mouse.click(box["x"] + first["x"], box["y"] + first["y"])
    assert state(page)["selected"] == 0
    panel = page.locator("#agent")
    assert scene.tracks.names[0] in panel.inner_text()
    assert "impatient" in panel.inner_text()
    assert "reckless, 70 %" in panel.inner_text()
    assert "cutting in front" in panel.inner_text()
    assert page.locator("img").count() == 0
    assert "GraphRQI replay" in page.title()
    page.keyboard.press("Escape")
    assert state(page)["selected"] == -1


def expected_color(scene, mode, row, time_s):
    """What an agent's colour should be, worked out from the scene."""
    look = int(np.searchsorted(scene.beliefs.time_s, time_s + 1e-6)) - 1
    probability = scene.beliefs.probability[row, look]
    stops = np.array([rgb(color) for color in RAMP], dtype=float)

    def on_ramp(share):
        at = np.linspace(0.0, 1.0, len(stops))
        return [np.interp(min(max(share, 0.0), 1.0), at, stops[:, i]) for i in range(3)]

    if mode == "true":
        return rgb(COLORS[BEHAVIORS[scene.tracks.behavior[row]]])
    if not np.isfinite(probability).all() and mode != "speed":
        return rgb(UNKNOWN_COLOR)
    if mode == "predicted":
        return rgb(COLORS[BEHAVIORS[int(probability.argmax())]])
    if mode == "confidence":
        return on_ramp((0.7 - 1 / 6) * 6 / 5)
    if mode == "speed":
        return on_ramp(np.nanmax(scene.tracks.speed[row]) / 8.0)
    w = scene.graph.w[:, int(np.searchsorted(scene.graph.time_s, time_s + 1e-6)) - 1]
    return on_ramp(float(np.sqrt(w[row] / np.nanmax(w))))


@pytest.mark.parametrize("mode", MODES)
def test_every_agent_has_the_colour_of_the_mode(open_page, scene, mode):
    page = open_page()
    page.evaluate("replay.seek(8.0)")
    page.keyboard.press(str(MODES.index(mode) + 1))
    assert state(page)["mode"] == mode
    drawn(page)
    image = np.asarray(Image.open(io.BytesIO(page.locator("#stage").screenshot())).convert("RGB"))
    agents = page.evaluate("replay.agents()")
    assert {a["index"] for a in agents} == set(range(7))
    for agent in agents:
        x, y = round(agent["x"]), round(agent["y"])
        if not (6 < x < image.shape[1] - 6):
            continue  # cut by the border of a folded road
        patch = image[y - 1 : y + 2, x - 5 : x + 1].reshape(-1, 3).astype(int)  # behind the glass
        wanted = np.array(expected_color(scene, mode, agent["index"], 8.0))
        near = np.abs(patch - wanted).max(axis=1) <= 12
        assert near.mean() > 0.7, (mode, agent["name"], wanted, np.median(patch, axis=0))


def test_graph_paths_and_names_are_drawn_when_asked_for(open_page):
    page = open_page()
    page.evaluate("replay.seek(6.0)")
    drawn(page)
    stage = page.locator("#stage")
    before = np.asarray(Image.open(io.BytesIO(stage.screenshot())).convert("RGB")).astype(int)
    for key, layer in (("g", "graph"), ("t", "paths"), ("m", "names")):
        page.keyboard.press(key)
        assert state(page)["layers"][layer] is True
        drawn(page)
        after = np.asarray(Image.open(io.BytesIO(stage.screenshot())).convert("RGB")).astype(int)
        assert (np.abs(after - before).max(axis=2) > 20).sum() > 150
        page.keyboard.press(key)


def test_every_control_has_a_name_and_can_be_reached_by_keyboard(open_page):
    page = open_page()
    unnamed = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, canvas[tabindex], summary")]
          .filter((e) => e.checkVisibility() && !(e.getAttribute("aria-label")
            || e.textContent.trim() || [...(e.labels || [])].some((l) => l.textContent.trim())))
          .map((e) => e.outerHTML)"""
    )
    assert unnamed == []
    reached, radios = set(), set()
    for _ in range(60):
        page.keyboard.press("Tab")
        found = page.evaluate("[document.activeElement.id, document.activeElement.name || '']")
        reached.add(found[0])
        radios.add(found[1])
    assert reached >= CONTROLS
    assert "mode" in radios


@pytest.mark.parametrize("size", SIZES)
def test_keys_select_agents_and_open_help(open_page, size):
    page = open_page(*SIZES[size])
    page.keyboard.press("n")
    assert state(page)["selected"] >= 0
    page.keyboard.press("?")
    assert page.locator("#keys").is_visible()
    assert "Space" in page.locator("#keys").inner_text()
    assert page.locator("#keys").evaluate("dialog => dialog.scrollTop") == 0
    page.keyboard.press("Escape")
    assert not page.locator("#keys").is_visible()
    page.keyboard.press("]")
    assert state(page)["time"] == pytest.approx(5.0)
    assert "collision" in page.locator("#said").inner_text()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read_and_nothing_overflows(open_page, contrasts, scheme, size):
    page = open_page(*SIZES[size], scheme=scheme)
    page.evaluate("replay.seek(6.0); replay.select(1)")
    page.locator("#keys").evaluate("dialog => dialog.show()")
    poor = [found for found in contrasts(page) if found[0] < 4.5]
    assert poor == []
    assert page.evaluate("document.documentElement.scrollWidth") <= SIZES[size][0]
    page.locator("#keys").evaluate("dialog => dialog.close()")
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.keyboard.press("l")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != background
    assert [found for found in contrasts(page) if found[0] < 4.5] == []


def test_the_timeline_leads_to_moments_and_agents(open_page):
    page = open_page()
    strip = page.locator("#timeline").bounding_box()
    labels = page.evaluate("replay.timeline().left")
    left, right = strip["x"] + labels, strip["x"] + strip["width"] - 6
    page.mouse.click(left + 0.75 * (right - left), strip["y"] + strip["height"] - 8)
    assert state(page)["time"] == pytest.approx(15.0, abs=0.2)
    middle_of_trait = left + 4.5 / 19.9 * (right - left)
    page.mouse.move(middle_of_trait, strip["y"] + 22)
    assert "cutting in front" in page.locator("#tip").inner_text()
    page.mouse.click(middle_of_trait, strip["y"] + 22)
    assert state(page)["selected"] == 0
    assert state(page)["time"] == pytest.approx(3.0, abs=0.05)


def test_a_link_opens_at_a_moment_with_an_agent(open_page):
    page = open_page(link="#t=12.5&agent=car-8&mode=speed")
    assert state(page)["time"] == pytest.approx(12.5)
    assert state(page)["selected"] == 2
    assert state(page)["mode"] == "speed"


def test_the_wheel_zooms_dragging_moves_and_follow_keeps_up(open_page):
    page = open_page()
    box = page.locator("#stage").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 150)
    page.mouse.wheel(0, -400)
    drawn(page)
    before = page.evaluate("replay.agents()")
    page.mouse.down()
    page.mouse.move(box["x"] + 360, box["y"] + 150, steps=4)
    page.mouse.up()
    after = {a["index"]: a["x"] for a in page.evaluate("replay.agents()")}
    moved = [after[a["index"]] - a["x"] for a in before if a["index"] in after]
    assert moved == pytest.approx([60.0] * len(moved), abs=1.0)
    page.evaluate("replay.select(3)")
    page.keyboard.press("f")
    page.keyboard.press("ArrowRight")
    drawn(page)
    chosen = next(a for a in page.evaluate("replay.agents()") if a["index"] == 3)
    assert chosen["x"] == pytest.approx(box["width"] / 2, abs=2.0)


def test_a_junction_shows_its_signals(open_page, make_scene, tmp_path):
    write_page(make_scene("four_way_intersection", agents=8), tmp_path / "four.html", "true")
    page = open_page(file=tmp_path / "four.html")
    drawn(page)
    image = np.asarray(Image.open(io.BytesIO(page.locator("#stage").screenshot())).convert("RGB"))
    red = np.abs(image.astype(int) - np.array([0xD3, 0x31, 0x2B])).max(axis=2) < 12
    assert red.sum() > 100


def test_it_opens_where_there_are_beliefs(open_page, scene):
    page = open_page()
    known = np.isfinite(scene.beliefs.probability).all(axis=2).any(axis=0)
    assert state(page)["time"] == pytest.approx(scene.beliefs.time_s[known][0])
    assert page.evaluate("replay.agents().filter((a) => a.likely >= 0).length") > 0


def test_unsure_drivers_have_a_dashed_outline(open_page, make_scene, tmp_path):
    sure = make_scene()
    one_style = np.array([0.34, 0.32, 0.3, 0.02, 0.01, 0.01], dtype=np.float32)
    doubted = dataclasses.replace(
        sure.beliefs, probability=sure.beliefs.probability * 0 + one_style
    )
    counts = []
    for name, beliefs in (("sure", sure.beliefs), ("unsure", doubted)):
        write_page(dataclasses.replace(sure, beliefs=beliefs), tmp_path / name, "predicted")
        (tmp_path / name).rename(tmp_path / f"{name}.html")
        page = open_page(file=tmp_path / f"{name}.html")
        page.evaluate("replay.seek(8.0)")
        drawn(page)
        shot = page.locator("#stage").screenshot()
        image = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)
        counts.append((np.abs(image - np.array([0x18, 0x20, 0x2B])).max(axis=2) < 25).sum())
    assert counts[1] < 0.9 * counts[0], "gaps in the outlines"


def test_a_tap_on_a_phone_shows_the_driver_beside_the_scene(open_page, scene):
    page = open_page(390, 844)
    page.evaluate("replay.seek(5.0)")
    assert not page.locator("#card").is_visible()
    agent = next(a for a in page.evaluate("replay.agents()") if a["index"] == 2)
    stage = page.locator("#stage").bounding_box()
    page.mouse.click(stage["x"] + agent["x"], stage["y"] + agent["y"])
    until(page, page.locator("#card").is_visible)
    card = page.locator("#card").bounding_box()
    assert card["y"] >= stage["y"] + stage["height"] - 1, "the scene stays in sight"
    assert card["y"] + card["height"] <= 844, "without scrolling"
    assert scene.tracks.names[2] in page.locator("#card").inner_text()
    assert "predicted" in page.locator("#card").inner_text()
    page.get_by_role("button", name="Close").first.click()
    assert state(page)["selected"] == -1
    wide = open_page()
    wide.evaluate("replay.select(2)")
    assert not wide.locator("#card").is_visible()
