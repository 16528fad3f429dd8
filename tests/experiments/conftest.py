"""A hand-made scene, and a browser to show it in."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS, PROFILES, Behavior, Trait
from behaviors.traits import ShownTrait
from experiments.replay.scene import (
    Beliefs,
    Futures,
    ReplayScene,
    graph_history,
    kept_steps,
    sampled,
)
from scenarios import SCENARIOS
from sim.frames import AgentKind, Event, EventKind, Tracks
from sim.scenario import AgentSpec
from sim.store.schema import EpisodeEntry

HOSTILE = '</script><img src=x onerror="document.title=1">'


@pytest.fixture(scope="session")
def make_scene():
    """A scene of cars that go their ways, one of which has a hostile name."""

    def make(scenario="straight_road", agents=8, seconds=20.0, name=HOSTILE):
        road = SCENARIOS[scenario]().road
        time_s = np.round(np.arange(0.0, seconds, 0.1), 3)
        ids = np.arange(agents, dtype=np.int64) * 3 + 2
        lanes = [lane for lane in road.lanes if not lane.walking and not lane.internal]
        xy = np.zeros((agents, time_s.size, 2))
        heading = np.zeros((agents, time_s.size))
        speed = np.repeat(np.linspace(1.0, 8.0, agents)[:, None], time_s.size, axis=1)
        for i in range(agents):
            a, b = lanes[i % len(lanes)].centerline[[0, -1]]
            unit = (b - a) / np.hypot(*(b - a))
            room = np.hypot(*(b - a)) * (i // len(lanes) + 0.5) / (agents // len(lanes) + 1)
            xy[i] = a + unit * (room + speed[i] * time_s)[:, None]
            heading[i] = np.arctan2(unit[1], unit[0])
        valid = np.ones((agents, time_s.size), dtype=bool)
        valid[-1, : time_s.size // 2] = False
        xy[~valid] = heading[~valid] = speed[~valid] = np.nan
        kind = np.zeros(agents, dtype=np.int8)
        kind[1] = AgentKind.TRUCK.code
        truth = (np.arange(agents) % len(BEHAVIORS)).astype(np.int8)
        tracks = Tracks.of_dense(
            ids=ids,
            names=(name, *(f"car-{i}" for i in ids[1:])),
            kind=kind,
            length=np.full(agents, 5.0),
            width=np.full(agents, 2.0),
            time_s=time_s,
            xy=xy,
            heading=heading,
            speed=speed,
            valid=valid,
            signals=np.zeros((len(road.signal_groups), time_s.size), dtype=np.int8),
            behavior=truth,
            events=(Event(EventKind.COLLISION, 5.0, int(ids[0]), int(ids[1]), HOSTILE),),
        )
        seen = kept_steps(tracks)
        probability = np.full((agents, seen.size, len(BEHAVIORS)), 0.06, dtype=np.float32)
        probability[np.arange(agents), :, (truth + 1) % len(BEHAVIORS)] = 0.7
        probability[:, :2] = np.nan
        ahead = np.arange(1, 11) * 0.5
        unit = np.stack([np.cos(heading), np.sin(heading)], axis=2)
        seconds = sampled(tracks, 1.0)[1:]
        place, rows = np.nonzero(valid[:, seconds].T)
        step = seconds[place]
        straight = (
            xy[rows, step, None]
            + unit[rows, step, None] * ((speed[rows, step, None] * ahead)[..., None])
        )
        futures = Futures(
            ahead_s=ahead,
            time_s=np.repeat(time_s[step], 2),
            agent=np.repeat(rows, 2),
            probability=np.tile([0.75, 0.25], rows.size),
            xy=np.stack([straight, straight + 2.0], axis=1).reshape(-1, ahead.size, 2),
        )
        entry = EpisodeEntry(
            scenario=scenario, engine="sumo", id="0" * 16, frames=time_s.size, agents=agents,
            agent_steps=int(valid.sum()),
        )  # fmt: skip
        specs = {
            int(i): AgentSpec(
                int(i), AgentKind.CAR, BEHAVIORS[c], PROFILES[BEHAVIORS[c]], (), 0.0, 5.0, 2.0
            )
            for i, c in zip(ids, truth, strict=True)
        }
        return ReplayScene(
            entry=entry,
            unit="m",
            road=road,
            tracks=tracks,
            agents=specs,
            shown_traits=(ShownTrait(Trait.CUTTING_IN, int(ids[0]), 3.0, 6.0, 1.0),),
            beliefs=Beliefs(ids, time_s[seen], probability),
            believer="a model",
            graph=graph_history(tracks),
            futures=futures,
            predictor="a predictor",
            notes=(HOSTILE,),
        )

    assert BEHAVIORS[0] is Behavior.IMPATIENT
    return make


@pytest.fixture(scope="session")
def browser():
    """Debian's Chromium, without a window."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield found
        found.close()


CONTRAST = """() => {
  const parse = (color) => {
    const [r, g, b, a = 1] = color.match(/[\\d.]+/g).map(Number);
    return [r, g, b, a];
  };
  const light = ([r, g, b]) => {
    const part = (v) => ((v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
  };
  const behind = (element) => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) {
      const color = parse(getComputedStyle(e).backgroundColor);
      if (color[3] > 0) layers.push(color);
      if (color[3] === 1) break;
    }
    return layers.reverse().reduce(
      (under, over) => under.map((v, i) => v + over[3] * (over[i] - v)), [255, 255, 255]);
  };
  const found = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const element = node.parentElement;
    if (!node.textContent.trim()) continue;
    if (["SCRIPT", "STYLE", "NOSCRIPT"].includes(element.tagName)) continue;
    if (!element.checkVisibility()) continue;
    const style = getComputedStyle(element);
    const ink = parse(element instanceof SVGElement ? style.fill : style.color);
    const [a, b] = [light(ink), light(behind(element))].sort((x, y) => y - x);
    found.push([(a + 0.05) / (b + 0.05), node.textContent.trim().slice(0, 40)]);
  }
  return found;
}"""


@pytest.fixture(scope="session")
def contrasts():
    """Of an open page: the contrast of every visible text with what is behind it."""
    return lambda page: page.evaluate(CONTRAST)
