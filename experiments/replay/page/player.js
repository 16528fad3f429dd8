// The player: time, choices, keys, pointers; what is drawn when.

const player = {
  time: 0, playing: false, rate: 1, mode: data.open.mode, selected: -1, hover: -1, follow: false,
  layers: { graph: false, paths: false, names: false }, present: new Map(), dirty: true,
};

const stage = $("stage"), strip = $("timeline");

function redraw() { player.dirty = true; }

function seek(time) {
  player.time = Math.min(duration, Math.max(0, time));
  redraw();
}

function play(on = !player.playing) {
  if (on && player.time >= duration - 1e-3) player.time = 0;
  player.playing = on;
  $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  $("play-shape").setAttribute("d", on ? "M5.5 4h3.2v12H5.5zM11.3 4h3.2v12h-3.2z" : "M6 3.8v12.4L16.2 10z");
  redraw();
}

function setRate(rate) {
  const known = Array.from($("rate").options, (o) => Number(o.value));
  player.rate = known.includes(rate) ? rate : player.rate;
  $("rate").value = String(player.rate);
}

function setMode(mode) {
  const radio = document.querySelector(`#modes input[value="${mode}"]`);
  if (!radio || radio.disabled) return;
  radio.checked = true;
  player.mode = mode;
  showLegend();
  redraw();
}

function setLayer(name, on) {
  player.layers[name] = on;
  $(name).checked = on;
  redraw();
}

function select(index) {
  player.selected = index;
  if (index < 0) follow(false);
  showAgent();
  $("said").textContent = index < 0 ? "Nobody selected" : `Selected ${titleOf(index)}`;
  redraw();
}

function selectNext(step) {
  const here = [...player.present.keys()];
  if (!here.length) return;
  const at = here.indexOf(player.selected);
  select(here[at < 0 ? (step > 0 ? 0 : here.length - 1) : (at + step + here.length) % here.length]);
}

function follow(on) {
  player.follow = on && player.selected >= 0;
  agentPanel.follow?.setAttribute("aria-pressed", String(player.follow));
  if (agentPanel.follow) agentPanel.follow.textContent = player.follow ? "Following" : "Follow";
  redraw();
}

function jumpToEvent(step) {
  const times = data.events.map((e) => e.time).sort((a, b) => a - b);
  const next = step > 0 ? times.find((t) => t > player.time + 0.05) : times.findLast((t) => t < player.time - 0.05);
  if (next === undefined) return;
  const event = data.events.find((e) => e.time === next);
  if (event.agent >= 0) select(event.agent);
  seek(next);
  $("said").textContent = eventText(event);
}

function toggleTheme() {
  document.documentElement.dataset.theme = isDark() ? "light" : "dark";
  readTheme();
  redraw();
}

function agentAt(px, py) {
  const panel = panelAt(px, py);
  let best = -1, nearest = 14;
  for (const [index, place] of player.present) {
    const [x, y] = toScreen(panel, place.x, place.y);
    const reach = Math.max(0, data.agents[index].length * panel.scale / 2 - 6);
    const away = Math.hypot(px - x, py - y) - reach;
    if (away < nearest) { nearest = away; best = index; }
  }
  return best;
}

const KEYS = {
  " ": () => play(), ArrowLeft: (e) => seek(player.time - (e.shiftKey ? 10 : 1)), ArrowRight: (e) => seek(player.time + (e.shiftKey ? 10 : 1)),
  ",": () => stepFrame(-1), ".": () => stepFrame(1), "<": () => nextRate(-1), ">": () => nextRate(1),
  "[": () => jumpToEvent(-1), "]": () => jumpToEvent(1), n: () => selectNext(1), p: () => selectNext(-1),
  f: () => follow(!player.follow), Escape: () => select(-1), g: () => setLayer("graph", !player.layers.graph),
  t: () => setLayer("paths", !player.layers.paths), m: () => setLayer("names", !player.layers.names),
  1: () => setMode("true"), 2: () => setMode("predicted"), 3: () => setMode("confidence"), 4: () => setMode("speed"), 5: () => setMode("w"),
  "+": () => zoomBy(1.3), "=": () => zoomBy(1.3), "-": () => zoomBy(1 / 1.3), 0: () => fitAll(),
  w: () => panBy(0, 60), s: () => panBy(0, -60), a: () => panBy(60, 0), d: () => panBy(-60, 0),
  l: toggleTheme, "?": () => $("keys").showModal(),
};

function stepFrame(step) { play(false); seek(arrays.time[Math.min(arrays.time.length - 1, Math.max(0, latest(arrays.time, player.time) + step))]); }
function nextRate(step) {
  const options = $("rate").options;
  setRate(Number(options[Math.min(options.length - 1, Math.max(0, $("rate").selectedIndex + step))].value));
}
function zoomBy(factor, x, y) { zoom(factor, x, y); redraw(); }
function panBy(dx, dy) { follow(false); pan(dx, dy); redraw(); }
function fitAll() { follow(false); fit(); redraw(); }

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open) return;
  const target = event.target, name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  // A control that has the focus keeps the keys it needs itself.
  const own = { BUTTON: [" ", "Enter"], SUMMARY: [" ", "Enter"], SELECT: "all", INPUT: target.type === "checkbox" ? [" "] : "arrows" }[target.tagName];
  if (own === "all" || (own === "arrows" && (name.startsWith("Arrow") || name === " ")) || (Array.isArray(own) && own.includes(name))) return;
  const act = KEYS[name];
  if (!act) return;
  event.preventDefault();
  act(event);
}

function listen() {
  document.addEventListener("keydown", onKey);
  $("play").onclick = () => play();
  $("previous").onclick = () => jumpToEvent(-1);
  $("next").onclick = () => jumpToEvent(1);
  $("theme").onclick = toggleTheme;
  $("help").onclick = () => $("keys").showModal();
  $("zoom-in").onclick = () => zoomBy(1.4);
  $("zoom-out").onclick = () => zoomBy(1 / 1.4);
  $("fit").onclick = fitAll;
  $("rate").onchange = () => setRate(Number($("rate").value));
  $("scrub").oninput = () => seek(Number($("scrub").value));
  $("modes").onchange = (event) => setMode(event.target.value);
  for (const name of Object.keys(player.layers)) $(name).onchange = () => setLayer(name, $(name).checked);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readTheme(); redraw(); });
  new ResizeObserver(resize).observe(stage);
  new ResizeObserver(resize).observe(strip.parentElement);
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomBy(Math.exp(-0.0016 * event.deltaY * (event.deltaMode ? 30 : 1)), event.offsetX, event.offsetY);
  }, { passive: false });
  listenToPointers();
  strip.addEventListener("pointerdown", onStrip);
  strip.addEventListener("pointermove", onStrip);
  strip.addEventListener("pointerleave", () => { $("tip").hidden = true; });
}

const pointers = new Map();
function listenToPointers() {
  let moved = 0;
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    moved = 0;
  });
  stage.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId), now = [event.offsetX, event.offsetY];
    if (!last) return hover(...now);
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const before = Math.hypot(last[0] - other[0], last[1] - other[1]), after = Math.hypot(now[0] - other[0], now[1] - other[1]);
      zoomBy(after / Math.max(before, 1), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else if ((moved += Math.hypot(now[0] - last[0], now[1] - last[1])) > 4) {
      stage.classList.add("dragging");
      panBy(now[0] - last[0], now[1] - last[1]);
    } else return;
    pointers.set(event.pointerId, now);
  });
  const up = (event) => {
    if (pointers.delete(event.pointerId) && event.type === "pointerup" && moved <= 4) select(agentAt(event.offsetX, event.offsetY));
    stage.classList.remove("dragging");
  };
  stage.addEventListener("pointerup", up);
  stage.addEventListener("pointercancel", up);
  stage.addEventListener("pointerleave", () => hover(-99, -99));
}

function hover(px, py) {
  const found = px < 0 ? -1 : agentAt(px, py), tip = $("tip");
  if (found !== player.hover) redraw();
  player.hover = found;
  stage.classList.toggle("over", found >= 0);
  tip.hidden = found < 0;
  if (found < 0) return;
  const truth = data.agents[found].truth, code = mostLikely(beliefOf(found, player.time));
  const words = [titleOf(found)];
  if (truth >= 0) words.push(`is ${data.behaviors[truth].name}`);
  if (code >= 0) words.push(`looks ${data.behaviors[code].name}`);
  showTip(words.join(" · "), px, py);
}

function showTip(text, px, py) {
  const tip = $("tip");
  tip.textContent = text;
  tip.hidden = false;
  tip.style.left = `${Math.max(4, Math.min(px + 12, view.width - tip.offsetWidth - 4))}px`;
  tip.style.top = `${Math.max(4, Math.min(py + 14, view.height - tip.offsetHeight - 4))}px`;
}

function onStrip(event) {
  const width = strip.clientWidth, mark = markAt(event.offsetX, event.offsetY);
  if (event.type === "pointerdown" || event.buttons) {
    if (event.type === "pointerdown") strip.setPointerCapture(event.pointerId);
    if (mark && event.type === "pointerdown") { if (mark.agent >= 0) select(mark.agent); seek(mark.time); return; }
    const left = gutter(width);
    seek((event.offsetX - left) / (width - left - 6) * duration);
  } else if (mark) showTip(mark.text(), event.offsetX, view.height);
  else $("tip").hidden = true;
}

function resize() {
  const dpr = devicePixelRatio || 1;
  view.width = Math.max(50, stage.clientWidth); view.height = Math.max(50, stage.clientHeight);
  stage.width = Math.round(view.width * dpr); stage.height = Math.round(view.height * dpr);
  strip.style.height = `${timeline.height}px`;
  strip.width = Math.round(strip.clientWidth * dpr); strip.height = Math.round(timeline.height * dpr);
  layOut();
  redraw();
}

let before = 0, panelShown = 0;
function tick(now) {
  const passed = Math.min(0.1, (now - before) / 1000);
  before = now;
  if (player.playing) {
    player.time += passed * player.rate;
    if (player.time >= duration) { player.time = duration; play(false); }
    player.dirty = true;
  }
  if (player.dirty) {
    player.dirty = false;
    if (player.follow) {
      const place = placeOf(player.selected, player.time);
      if (place) centreOn(place.x, place.y);
    }
    draw(stage);
    drawTimeline(strip, strip.clientWidth);
    $("scrub").value = String(player.time);
    $("clock").textContent = `${(data.begin + player.time).toFixed(1)} / ${(data.begin + duration).toFixed(1)} s`;
    if (!player.playing || now - panelShown > 120) { panelShown = now; updateAgent(); countAgents(); }
  }
  requestAnimationFrame(tick);
}

// Links into a replay: replay.html#t=34.5&agent=12&mode=predicted
function readLink() {
  const wanted = new URLSearchParams(location.hash.slice(1));
  if (wanted.has("mode")) setMode(wanted.get("mode"));
  if (wanted.has("agent")) select(data.agents.findIndex((a) => a.name === wanted.get("agent")));
  if (wanted.has("t")) seek(Number(wanted.get("t")) - data.begin || 0);
}

async function start() {
  arrays = await readArrays();
  places = readPlaces(arrays);
  futures = readFutures(arrays);
  ghosts = readGhosts(arrays);
  duration = arrays.time[arrays.time.length - 1];
  $("scrub").max = String(duration);
  if (data.agents.every((agent) => agent.truth < 0)) document.querySelector('#modes input[value="true"]').disabled = true;
  if (!futures) { $("paths").disabled = true; }
  readTheme();
  setUpView();
  setUpShapes();
  setUpTimeline();
  resize();
  setMode(player.mode);
  showNotes();
  showEvents();
  showAgent();
  seek(data.open.at - data.begin);
  readLink();
  listen();
  addEventListener("hashchange", readLink);
  requestAnimationFrame(tick);
  // For scripts that drive the page.
  window.replay = {
    seek: (time) => seek(time - data.begin), select, setMode, setLayer, play,
    futures: (index) => {
      const made = futuresOf(index, player.time);
      return made && made.futures.map((m) => ({ time: data.begin + made.time, probability: futures.probability[m] / 255, places: futurePoints(m, null, 0) }));
    },
    // Milliseconds that drawing takes at a time, until every pixel is there.
    cost: (time) => {
      const began = performance.now();
      player.time = time - data.begin;
      draw(stage); drawTimeline(strip, strip.clientWidth);
      for (const canvas of [stage, strip]) canvas.getContext("2d").getImageData(0, 0, 1, 1);
      redraw();
      return performance.now() - began;
    },
    boxes: (what) => labels[what === "agents" ? "agents" : "shown"], edges: () => edgesShown,
    timeline: () => ({ left: gutter(strip.clientWidth), labels: timeline.drawn }),
    state: () => ({ time: data.begin + player.time, playing: player.playing, mode: player.mode, selected: player.selected, layers: { ...player.layers } }),
    agents: () => view.panels.flatMap((panel) => [...everyone(player.time)].map(([index, place]) => {
      const [x, y] = toScreen(panel, place.x, place.y);
      return { index, name: data.agents[index].name, x, y, at: [place.x, place.y], color: colorOf(index, place), truth: data.agents[index].truth, likely: mostLikely(beliefOf(index, player.time)) };
    }).filter(({ x, y }) => x >= panel.left && x <= panel.left + panel.width && y >= panel.top && y <= panel.top + panel.height)),
  };
  document.body.dataset.ready = "yes";
}

start();
