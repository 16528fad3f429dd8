// The panels beside the scene: legend, selected agent, events, facts. Text only ever enters as text.

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "class") made.className = value;
    else if (name === "color") made.style.background = value;
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

function swatch(color) { return element("span", { class: "swatch", color, "aria-hidden": "true" }); }

const NUMBERS = {
  confidence: () => ({ title: "Confidence", low: "17\u00a0% (a guess)", high: "100\u00a0%", note: "Probability of the likeliest behaviour." }),
  speed: () => ({ title: "Speed", low: "0", high: `${topSpeed()} ${data.unit}/s and more`, note: "" }),
  w: () => ({ title: "Prominence", low: "0", high: "the largest now", note: "How much an agent stands out among its neighbours in the traffic graph: |w| of w = L u. Square-root scale." }),
};

function showLegend() {
  const parts = [];
  if (NUMBERS[player.mode]) {
    const { title, low, high, note } = NUMBERS[player.mode]();
    const bar = element("div", { class: "ramp" });
    bar.style.background = `linear-gradient(90deg, ${data.ramp.join(", ")})`;
    parts.push(element("h2", {}, title), bar, element("div", { class: "ticks" }, element("span", {}, low), element("span", {}, high)));
    if (note) parts.push(element("p", { class: "quiet" }, note));
    if (player.mode !== "speed") parts.push(element("ul", { class: "swatches quiet" }, element("li", {}, swatch(data.unknown), "nothing known")));
  } else {
    parts.push(element("h2", {}, player.mode === "true" ? "True behaviour" : `Predicted by ${data.facts.beliefs}`));
    const list = element("ul", { class: "swatches" });
    const half = data.behaviors.length / 2;
    list.append(element("li", { class: "head" }, data.behaviors[0].style), element("li", { class: "head" }, data.behaviors[half].style));
    for (let i = 0; i < half; i++) for (const code of [i, i + half]) list.append(legendRow(data.behaviors[code].color, data.behaviors[code].name, code));
    const rest = legendRow(data.unknown, "does not drive, or not known", -1);
    rest.className = "wide";
    list.append(rest);
    parts.push(list);
  }
  if (player.mode === "predicted" || player.mode === "confidence") parts.push(element("p", { class: "quiet", id: "sure" }));
  const marks = element("ul", { class: "marks" });
  for (const [picture, text] of legendMarks()) marks.append(element("li", {}, icon(picture), text));
  parts.push(marks);
  $("legend").replaceChildren(...parts);
}

function legendRow(color, name, code) {
  return element("li", {}, swatch(color), name, element("span", { class: "count", "data-code": code, title: "in sight now" }));
}

function legendMarks() {
  const marks = [];
  if (player.mode === "predicted") marks.push([["rect", { x: 2, y: 2, width: 18, height: 8, rx: 2, fill: "none", "stroke-width": 1.6, "stroke-dasharray": "3 2.5" }], "less than 50 % sure"]);
  if (futures) {
    marks.push([["line", { x1: 1, y1: 6, x2: 21, y2: 6, "stroke-width": 3.5 }], "predicted"]);
    marks.push([["line", { x1: 1, y1: 6, x2: 21, y2: 6, "stroke-width": 1.6, "stroke-dasharray": "1.5 3.5" }], "what happened"]);
  }
  if (data.events.some((e) => e.kind === data.grave[0])) marks.push([["path", { d: "M7 2l8 8M15 2l-8 8", "stroke-width": 2 }], "collision"]);
  if (data.events.some((e) => e.kind === data.grave[1])) marks.push([["path", { d: "M11 1.5l5 9h-10z", "stroke-width": 1.6, fill: "none" }], "near miss"]);
  return marks;
}

function icon([tag, attributes]) {
  const space = "http://www.w3.org/2000/svg", svg = document.createElementNS(space, "svg"), shape = document.createElementNS(space, tag);
  svg.setAttribute("viewBox", "0 0 22 12"); svg.setAttribute("aria-hidden", "true");
  for (const [name, value] of Object.entries({ stroke: "currentColor", ...attributes })) shape.setAttribute(name, value);
  svg.append(shape);
  return svg;
}

// How sure the classifier is of those in sight, and of how many it says nothing.
function sayHowSure() {
  if (!$("sure")) return;
  const drivers = [...player.present.keys()].filter((index) => data.kinds[data.agents[index].kind] !== "pedestrian");
  const known = drivers.map((index) => beliefOf(index, player.time)).filter((belief) => belief);
  const mean = known.reduce((sum, belief) => sum + Math.max(...belief), 0) / known.length;
  const sure = known.length ? `${Math.round(100 * mean)}\u00a0% sure on average` : "nothing believed yet";
  const labelled = known.filter(isLabelled).length;
  $("sure").textContent = `In sight now: ${sure}, ${drivers.length - labelled} of ${drivers.length} drivers unknown.`;
}

function countAgents() {
  sayHowSure();
  const spans = $("legend").querySelectorAll(".count");
  if (!spans.length) return;
  const counts = {};
  for (const index of player.present.keys()) {
    const code = player.mode === "true" ? data.agents[index].truth : answerTo(beliefOf(index, player.time));
    counts[code] = (counts[code] || 0) + 1;
  }
  for (const span of spans) span.textContent = counts[span.dataset.code] || "0";
}

const agentPanel = {};

function showAgent() {
  const index = player.selected;
  $("card").hidden = index < 0;
  if (index < 0) {
    $("agent").replaceChildren(element("p", { class: "quiet" }, "Click an agent, or press N, to see what is known and believed about it."));
    return;
  }
  const agent = data.agents[index], parts = [];
  agentPanel.swatch = swatch(data.unknown);
  agentPanel.follow = element("button", { type: "button", "aria-pressed": String(player.follow), onclick: () => follow(!player.follow) }, "Follow");
  parts.push(element("div", { class: "who" }, agentPanel.swatch, element("h2", {}, titleOf(index)), agentPanel.follow,
    element("button", { type: "button", class: "icon", "aria-label": "Select nobody", onclick: () => select(-1) }, "✕")));
  agentPanel.now = element("dl", { class: "said-is" });
  parts.push(agentPanel.now);
  agentPanel.card = element("dl", { class: "said-is" });
  $("card").replaceChildren(element("div", { class: "who" }, element("h2", {}, titleOf(index)),
    element("button", { type: "button", class: "icon", "aria-label": "Close", onclick: () => select(-1) }, "✕")), agentPanel.card);
  if (believed(index)) {
    agentPanel.chart = element("canvas", { id: "belief-chart", role: "img", "aria-label": "Belief over the time it is in sight: the higher a band, the likelier its behaviour" });
    agentPanel.bars = element("div", { class: "bars" });
    parts.push(element("h2", {}, "Belief over time"), agentPanel.chart, agentPanel.bars);
  } else {
    agentPanel.chart = agentPanel.bars = null;
  }
  parts.push(...traitList(index), ...profileTable(agent));
  $("agent").replaceChildren(...parts);
  updateAgent();
}

function believed(index) {
  for (let look = 0; look < arrays.beliefTime.length; look++) if (beliefAt(index, look)) return true;
  return false;
}

function traitList(index) {
  const shown = data.shownTraits.filter((x) => x[1] === index);
  if (!shown.length) return [];
  const list = element("ul", { class: "list" });
  for (const [trait, , begin, end] of shown) {
    const item = jump(begin, data.traits[trait].name, data.behaviors[data.traits[trait].behavior].color);
    item.firstChild.append(element("span", { class: "lasts" }, `for ${(end - begin).toFixed(1)} s`));
    list.append(item);
  }
  return [element("details", { open: "" }, element("summary", {}, `Traits shown (${shown.length})`), list)];
}

function jump(time, text, color, agent = -1) {
  const button = element("button", { type: "button", onclick: () => { if (agent >= 0) select(agent); seek(time); } },
    element("span", { class: "when" }, seconds(time)), ...(color ? [swatch(color)] : []), element("span", {}, text));
  return element("li", {}, button);
}

const UNITS = { s: "s", m: "m", mps2: "m/s²", min: "/min" };

function profileTable({ profile }) {
  if (!profile) return [];
  const table = element("table");
  for (const [name, value] of profile) {
    const found = name.match(/^(.*?)(?:_per)?_(s|m|mps2|min)$/);
    const words = (found ? found[1] : name).replaceAll("_", " "), unit = found ? UNITS[found[2]] : "";
    table.append(element("tr", {}, element("th", { scope: "row" }, words), element("td", {}, `${value} ${unit}`.trim())));
  }
  return [element("details", {}, element("summary", {}, "Profile it was drawn with"), table)];
}

function updateAgent() {
  const index = player.selected;
  if (index < 0 || !agentPanel.now) return;
  const agent = data.agents[index], place = player.present.get(index), belief = beliefOf(index, player.time);
  agentPanel.swatch.style.background = place ? colorOf(index, place) : data.unknown;
  const rows = [];
  if (agent.truth >= 0) rows.push(["truth", swatch(data.behaviors[agent.truth].color), data.behaviors[agent.truth].name]);
  const code = place ? mostLikely(belief) : -1, labelled = isLabelled(belief);
  if (code >= 0 && !labelled) rows.push(["predicted", swatch(data.unknown), `unknown; nearest to ${data.behaviors[code].name}, ${Math.round(100 * belief[code])}\u00a0%`]);
  else if (code >= 0) rows.push(["predicted", swatch(data.behaviors[code].color), `${data.behaviors[code].name}, ${Math.round(100 * belief[code])} %`]);
  else rows.push(["predicted", !place ? "not in sight" : data.kinds[agent.kind] === "pedestrian" ? "does not drive" : "not yet known"]);
  if (place) {
    rows.push(["speed", data.unit === "m" ? `${place.speed.toFixed(1)} m/s (${Math.round(3.6 * place.speed)} km/h)` : `${place.speed.toFixed(1)} ${data.unit}/s`]);
    const w = wOf(index, player.time);
    if (w) rows.push(["prominence", `${w.value < 0.005 ? 0 : w.value.toPrecision(2)} (${Math.round(100 * w.share ** 2)} % of the largest)`]);
  }
  const expected = place && futuresOf(index, player.time);
  if (expected) rows.push(["futures", expected.futures.map((m) => `${Math.round(futures.probability[m] / 2.55)}\u00a0%`).join(", ")]);
  const listed = () => rows.flatMap(([name, ...what]) => [element("dt", {}, name), element("dd", {}, ...what.map((part) => part.cloneNode ? part.cloneNode(true) : part))]);
  agentPanel.now.replaceChildren(...listed());
  agentPanel.card.replaceChildren(...listed());
  if (agentPanel.chart) { drawBeliefs(agentPanel.chart, index); showBars(place ? belief : null); }
}

function showBars(belief) {
  const rows = data.behaviors.flatMap((behavior, code) => {
    const share = belief ? Math.round(100 * belief[code]) : 0, fill = element("div", { class: "fill", color: behavior.color });
    fill.style.width = `${share}%`;
    return [element("span", {}, behavior.name), element("div", { class: "track" }, fill), element("span", { class: "share" }, belief ? `${share}\u00a0%` : "–")];
  });
  agentPanel.bars.replaceChildren(...rows);
}

// Bands of the six probabilities, stacked, over the time that the agent is in sight.
function drawBeliefs(canvas, index) {
  const width = canvas.clientWidth, height = canvas.clientHeight, dpr = devicePixelRatio || 1;
  if (!width) return;
  canvas.width = width * dpr; canvas.height = height * dpr;
  const ctx = canvas.getContext("2d");
  ctx.setTransform(dpr, 0, 0, dpr, 0, 0);
  ctx.fillStyle = theme.hover; ctx.fillRect(0, 0, width, height - 16);
  const [begin, end] = lifeOf(index), x = (t) => (t - begin) / Math.max(end - begin, 0.1) * width;
  const looks = [];
  for (let look = 0; look < arrays.beliefTime.length; look++) { const belief = beliefAt(index, look); if (belief) looks.push([arrays.beliefTime[look], belief]); }
  const tall = height - 16;
  if (looks.length) looks.push([Math.min(end, looks[looks.length - 1][0] + 0.5), looks[looks.length - 1][1]]);
  const below = looks.map(() => 0);
  data.behaviors.forEach((behavior, code) => {
    ctx.fillStyle = behavior.color; ctx.beginPath();
    looks.forEach(([t], i) => ctx.lineTo(x(t), tall * (1 - below[i])));
    for (let i = looks.length - 1; i >= 0; i--) { below[i] += looks[i][1][code]; ctx.lineTo(x(looks[i][0]), tall * (1 - below[i])); }
    ctx.fill();
  });
  ctx.fillStyle = theme.muted; ctx.font = "11px system-ui, 'DejaVu Sans', sans-serif"; ctx.textBaseline = "bottom";
  ctx.textAlign = "left"; ctx.fillText(seconds(begin), 0, height);
  ctx.textAlign = "right"; ctx.fillText(seconds(end), width, height);
  const now = x(player.time);
  if (now >= 0 && now <= width) { ctx.strokeStyle = theme.outline; ctx.lineWidth = 2; ctx.beginPath(); ctx.moveTo(now, 0); ctx.lineTo(now, tall); ctx.stroke(); }
}

const MOST_LISTED = 500;

// Of many events only the grave ones are listed, and of many of these the first.
function showEvents() {
  if (!data.events.length) return;
  const list = element("ul", { class: "list" }), many = data.events.length > MOST_LISTED;
  const listed = many ? data.events.filter((e) => data.grave.includes(e.kind)).slice(0, MOST_LISTED) : data.events;
  for (const event of listed) {
    const who = [event.agent, event.other].filter((i) => i >= 0).map(titleOf).join(", ");
    list.append(jump(event.time, `${event.kind}: ${who}${event.rule ? ` (${event.rule})` : ""}`, null, event.agent));
  }
  $("events").replaceChildren(element("details", { open: "" }, element("summary", {}, many ? `Events (the ${listed.length} gravest of ${data.events.length})` : `Events (${data.events.length})`), list));
}

function showNotes() {
  const facts = element("dl");
  for (const [name, value] of Object.entries(data.facts)) facts.append(element("dt", {}, name), element("dd", {}, String(value)));
  const parts = [element("h2", {}, "About this data"), facts];
  if (data.notes.length) parts.push(element("ul", {}, ...data.notes.map((note) => element("li", {}, note))));
  $("notes").replaceChildren(...parts);
  $("facts").textContent = `${data.facts.engine ?? data.facts.format} · ${data.agents.length} agents · ${duration.toFixed(0)} s`;
}
