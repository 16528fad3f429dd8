// Draws the scene onto its canvas: the road, then everything that moves.

const edgesShown = [];
const STUB = 26;   // pixels of an edge that are drawn towards somebody out of sight

function inPanel(panel, [x, y]) {
  return x >= panel.left && x <= panel.left + panel.width && y >= panel.top && y <= panel.top + panel.height;
}

// An edge between two in sight; a stub if one of them is out of sight; nothing if both are.
function clippedEdge(panel, from, to) {
  const [begins, ends] = [inPanel(panel, from), inPanel(panel, to)];
  if (begins && ends) return [from, to];
  if (!begins && !ends) return null;
  const [near, far] = begins ? [from, to] : [to, from];
  const share = Math.min(1, STUB / (Math.hypot(far[0] - near[0], far[1] - near[1]) || 1));
  return [near, [near[0] + share * (far[0] - near[0]), near[1] + share * (far[1] - near[1])]];
}

function drawGraph(ctx, panel, present) {
  const look = latest(arrays.graphTime, player.time);
  ctx.strokeStyle = theme.edge; ctx.globalAlpha = 0.5; ctx.lineWidth = 1;
  ctx.beginPath();
  for (let i = 0; i < arrays.edgeA.length && arrays.edgeBegin[i] <= look; i++) {
    if (arrays.edgeEnd[i] <= look) continue;
    const from = present.get(arrays.edgeA[i]), to = present.get(arrays.edgeB[i]);
    if (!from || !to) continue;
    const ends = clippedEdge(panel, toScreen(panel, from.x, from.y), toScreen(panel, to.x, to.y));
    if (!ends) continue;
    edgesShown.push(ends);
    ctx.moveTo(...ends[0]);
    ctx.lineTo(...ends[1]);
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function outlinePath(ctx, kind, long, wide) {
  ctx.beginPath();
  if (kind === "pedestrian") ctx.arc(0, 0, Math.max(long, wide) / 2, 0, 2 * Math.PI);
  else if (kind === "bicycle" || kind === "motorcycle") ctx.ellipse(0, 0, long / 2, wide / 2, 0, 0, 2 * Math.PI);
  else ctx.roundRect(-long / 2, -wide / 2, long, wide, Math.min(wide * 0.28, kind === "bus" || kind === "truck" ? wide * 0.12 : 99));
}

function drawAgent(ctx, panel, dpr, index, place, color) {
  const agent = data.agents[index];
  const kind = data.kinds[agent.kind];
  const [x, y] = toScreen(panel, place.x, place.y);
  const turn = view.turned ? Math.PI / 2 - place.heading : -place.heading;
  const cos = Math.cos(turn), sin = Math.sin(turn);
  // True size, but never so small that the colour cannot be seen.
  const long = Math.max(agent.length * panel.scale, kind === "pedestrian" ? 5 : 6);
  const wide = Math.max(agent.width * panel.scale, kind === "pedestrian" ? 5 : 3.6);
  if (x < panel.left - long || x > panel.left + panel.width + long || y < panel.top - long || y > panel.top + panel.height + long) return;
  const angle = view.turned ? Math.atan2(Math.cos(place.heading), Math.sin(place.heading)) : turn;
  ctx.setTransform(dpr * Math.cos(angle), dpr * Math.sin(angle), -dpr * Math.sin(angle), dpr * Math.cos(angle), dpr * x, dpr * y);
  if (index === player.selected || index === player.hover) {
    outlinePath(ctx, kind, long + 9, wide + 9);
    ctx.strokeStyle = theme.accent; ctx.lineWidth = index === player.selected ? 3 : 1.6;
    ctx.stroke();
  }
  outlinePath(ctx, kind, long, wide);
  ctx.fillStyle = color; ctx.fill();
  const unsure = player.mode === "predicted" && isUnsure(index);
  ctx.strokeStyle = theme.outline; ctx.lineWidth = unsure ? 1.6 : long > 12 ? 1.1 : 0.8;
  if (unsure) ctx.setLineDash([3, 2.5]);
  ctx.stroke();
  ctx.setLineDash([]);
  if (long < 11 || kind === "pedestrian") return;
  ctx.fillStyle = "rgba(10,14,20,.62)";
  ctx.beginPath();
  if (kind === "bicycle" || kind === "motorcycle") {
    ctx.arc(-long * 0.06, 0, wide * 0.36, 0, 2 * Math.PI);
  } else if (kind === "car") {
    ctx.moveTo(long * 0.1, -wide * 0.36); ctx.lineTo(long * 0.26, -wide * 0.41);
    ctx.lineTo(long * 0.26, wide * 0.41); ctx.lineTo(long * 0.1, wide * 0.36);
    ctx.closePath();
    ctx.moveTo(-long * 0.34, -wide * 0.36); ctx.lineTo(-long * 0.26, -wide * 0.32);
    ctx.lineTo(-long * 0.26, wide * 0.32); ctx.lineTo(-long * 0.34, wide * 0.36);
    ctx.closePath();
  } else {
    const front = kind === "truck" ? [0.39, 0.06] : [0.43, 0.04];
    ctx.rect(long * front[0], -wide * 0.42, long * front[1], wide * 0.84);
    if (kind === "truck") ctx.rect(long * 0.27, -wide / 2, Math.max(1, long * 0.02), wide);
    else { ctx.rect(-long * 0.44, -wide * 0.46, long * 0.84, wide * 0.08); ctx.rect(-long * 0.44, wide * 0.38, long * 0.84, wide * 0.08); }
  }
  ctx.fill();
}

// From so many in sight on, they are drawn as plain boxes, all of one colour at once.
const CROWD = 250;
const MOST_NAMED = 150;   // names are drawn up to so many in sight

// Those whose outline may reach into the panel: index, place, and where that is on the screen.
function inSight(panel, present) {
  const found = [];
  for (const [index, place] of present) {
    const [x, y] = toScreen(panel, place.x, place.y), reach = 6 + data.agents[index].length * panel.scale;
    if (x < panel.left - reach || x > panel.left + panel.width + reach || y < panel.top - reach || y > panel.top + panel.height + reach) continue;
    found.push({ index, place, x, y });
  }
  return found;
}

function drawAgents(ctx, panel, dpr, seen) {
  if (seen.length <= CROWD) {
    for (const { index, place } of seen) drawAgent(ctx, panel, dpr, index, place, colorOf(index, place));
    return;
  }
  const single = [], groups = new Map();
  for (const one of seen) {
    const { index, place, x, y } = one, { length, width, kind } = data.agents[index];
    if (index === player.selected || index === player.hover || length * panel.scale >= 11) { single.push(one); continue; }
    const color = colorOf(index, place), dashed = player.mode === "predicted" && isUnsure(index), key = dashed ? `${color} dashed` : color;
    if (!groups.has(key)) groups.set(key, { color, dashed, path: new Path2D() });
    const { path } = groups.get(key), walks = data.kinds[kind] === "pedestrian";
    const long = Math.max(length * panel.scale, walks ? 5 : 6) / 2, wide = Math.max(width * panel.scale, walks ? 5 : 3.6) / 2;
    const turn = view.turned ? Math.atan2(Math.cos(place.heading), Math.sin(place.heading)) : -place.heading;
    const ax = long * Math.cos(turn), ay = long * Math.sin(turn), bx = -wide * Math.sin(turn), by = wide * Math.cos(turn);
    path.moveTo(x + ax + bx, y + ay + by); path.lineTo(x + ax - bx, y + ay - by);
    path.lineTo(x - ax - bx, y - ay - by); path.lineTo(x - ax + bx, y - ay + by); path.closePath();
  }
  ctx.setTransform(dpr, 0, 0, dpr, 0, 0);
  ctx.strokeStyle = theme.outline;
  for (const { color, dashed, path } of groups.values()) {
    ctx.fillStyle = color; ctx.fill(path);
    ctx.lineWidth = dashed ? 1.2 : 0.7; ctx.setLineDash(dashed ? [3, 2.5] : []);
    ctx.stroke(path);
  }
  ctx.setLineDash([]);
  for (const { index, place } of single) drawAgent(ctx, panel, dpr, index, place, colorOf(index, place));
}

// A dashed outline where somebody factually was.
function drawGhost(ctx, panel, dpr, ghost) {
  const kind = data.kinds[ghost.kind], [x, y] = toScreen(panel, ghost.x, ghost.y);
  const long = Math.max(ghost.length * panel.scale, 6), wide = Math.max(ghost.width * panel.scale, 3.6);
  const angle = view.turned ? Math.atan2(Math.cos(ghost.heading), Math.sin(ghost.heading)) : -ghost.heading;
  ctx.setTransform(dpr * Math.cos(angle), dpr * Math.sin(angle), -dpr * Math.sin(angle), dpr * Math.cos(angle), dpr * x, dpr * y);
  outlinePath(ctx, kind, long, wide);
  ctx.setLineDash([3, 2]);
  ctx.strokeStyle = theme.muted; ctx.lineWidth = 1.2; ctx.stroke();
  ctx.setLineDash([]);
}

function line(ctx, panel, points) {
  ctx.beginPath();
  points.forEach(([x, y], i) => (i ? ctx.lineTo(...toScreen(panel, x, y)) : ctx.moveTo(...toScreen(panel, x, y))));
  ctx.stroke();
}

// The places of a future that are later than so many seconds from its instant on.
function futurePoints(m, from, since) {
  const points = from ? [[from.x, from.y]] : [];
  for (let h = 0; h < futures.ahead.length; h++) {
    if (futures.ahead[h] <= since) continue;
    const at = 2 * (m * futures.ahead.length + h);
    points.push([futures.xy[at], futures.xy[at + 1]]);
  }
  return points;
}

function drawFutures(ctx, panel, index, color, all) {
  const made = futuresOf(index, player.time);
  if (!made) return;
  // Of everyone, what is left of the likeliest; of one, all from the instant of prediction on.
  const since = all ? player.time - made.time : 0;
  const from = all ? player.present.get(index) : placeOf(index, made.time);
  ctx.lineCap = "round"; ctx.lineJoin = "round";
  const shown = all ? made.futures.slice(0, 1) : [...made.futures].reverse();
  for (const m of shown) {
    const p = futures.probability[m] / 255, points = futurePoints(m, from, since);
    if (!all) {
      ctx.strokeStyle = theme.outline; ctx.globalAlpha = 0.85; ctx.lineWidth = 3.4 + 4 * p;
      line(ctx, panel, points);
    }
    ctx.strokeStyle = color; ctx.globalAlpha = all ? 0.8 : 1; ctx.lineWidth = all ? 1.6 : 1.8 + 4 * p;
    line(ctx, panel, points);
  }
  ctx.globalAlpha = 1;
  if (all) return;
  drawHappened(ctx, panel, index, made.time);
  labelFutures(ctx, panel, made.futures, from || placeOf(index, player.time));
}

// What really happened from the same instant on.
function drawHappened(ctx, panel, index, time) {
  const points = [];
  for (let t = time; t <= time + futures.ahead[futures.ahead.length - 1] + 1e-6; t += 0.25) {
    const place = placeOf(index, t);
    if (!place) break;
    points.push([place.x, place.y]);
  }
  if (points.length < 2) return;
  ctx.strokeStyle = theme.ink; ctx.lineWidth = 1.6; ctx.setLineDash([1.5, 4.5]);
  line(ctx, panel, points);
  ctx.setLineDash([]);
  const [x, y] = toScreen(panel, ...points[points.length - 1]);
  ctx.beginPath(); ctx.arc(x, y, 3.6, 0, 2 * Math.PI); ctx.fillStyle = theme.paper; ctx.fill(); ctx.stroke();
}

// The probability at the end of each future, where there is room for it.
function labelFutures(ctx, panel, made, from) {
  for (const m of made) {
    const p = futures.probability[m] / 255;
    if (p < 0.05) continue;
    const at = 2 * ((m + 1) * futures.ahead.length - 1);
    const [x, y] = toScreen(panel, futures.xy[at], futures.xy[at + 1]), [x0, y0] = toScreen(panel, from.x, from.y);
    if (Math.hypot(x - x0, y - y0) < 24) continue;      // it stands
    labels.place(ctx, panel, x, y, 6, `${Math.round(100 * p)}\u00a0%`);
  }
}

const LABEL_FONT = "600 11.5px system-ui, 'DejaVu Sans', sans-serif", LABEL_TALL = 17;

// Labels of one panel: none covers an agent or another label, and one without room is left out.
const labels = {
  taken: [], shown: [], agents: [],
  begin(panel, seen) {
    this.taken = [];
    for (const { index, place, x, y } of seen) {
      const agent = data.agents[index];
      const long = Math.max(agent.length * panel.scale, 6), wide = Math.max(agent.width * panel.scale, 4);
      const turn = view.turned ? Math.PI / 2 - place.heading : place.heading;
      const cos = Math.abs(Math.cos(turn)), sin = Math.abs(Math.sin(turn));
      const w = long * cos + wide * sin, h = long * sin + wide * cos;
      const box = [x - w / 2, y - h / 2, x + w / 2, y + h / 2];
      this.taken.push(box);
      if (inPanel(panel, [x, y])) this.agents.push(box);
    }
  },
  isFree(box) {
    return !this.taken.some(([l, t, r, b]) => box[0] < r && box[2] > l && box[1] < b && box[3] > t);
  },
  // Beside, above or below a place that is so many pixels large.
  place(ctx, panel, x, y, reach, text) {
    ctx.font = LABEL_FONT;
    const w = ctx.measureText(text).width + 9, h = LABEL_TALL, far = reach + 3;
    const corners = [[x + far, y - h / 2], [x - far - w, y - h / 2], [x - w / 2, y - far - h], [x - w / 2, y + far], [x + far, y - far - h], [x + far, y + far], [x - far - w, y - far - h], [x - far - w, y + far]];
    for (const [left, top] of corners) {
      const box = [left, top, left + w, top + h];
      if (!inPanel(panel, [left, top]) || !inPanel(panel, [left + w, top + h]) || !this.isFree(box)) continue;
      this.taken.push(box);
      this.shown.push(box);
      tag(ctx, left, top + h / 2, text);
      return box;
    }
    return null;
  },
};

function tag(ctx, x, y, text) {
  ctx.font = LABEL_FONT;
  const width = ctx.measureText(text).width + 9;
  ctx.fillStyle = theme.paper; ctx.globalAlpha = 0.9;
  ctx.beginPath(); ctx.roundRect(x, y - 8.5, width, 17, 4); ctx.fill();
  ctx.globalAlpha = 1; ctx.fillStyle = theme.ink; ctx.textBaseline = "middle"; ctx.textAlign = "left";
  ctx.fillText(text, x + 4.5, y + 0.5);
}

// A cross or a triangle in a ring where somebody collided or nearly did, for two seconds.
function drawEvents(ctx, panel) {
  for (const event of data.events) {
    const since = player.time - event.time;
    if (since < -0.2 || since > 2 || !data.grave.includes(event.kind) || event.agent < 0) continue;
    const place = placeOf(event.agent, event.time);
    if (!place) continue;
    const [x, y] = toScreen(panel, place.x, place.y);
    ctx.globalAlpha = 1 - Math.max(0, since) / 2.2;
    if (event.kind !== data.grave[0]) tag(ctx, x + 24, y, event.rule);
    ctx.strokeStyle = theme.grave; ctx.lineWidth = 2.4;
    ctx.beginPath(); ctx.arc(x, y, 12 + 6 * Math.max(0, since), 0, 2 * Math.PI); ctx.stroke();
    if (event.kind !== data.grave[0]) {
      ctx.lineWidth = 1.8;
      ctx.beginPath(); ctx.moveTo(x, y - 7); ctx.lineTo(x + 6, y + 4.5); ctx.lineTo(x - 6, y + 4.5); ctx.closePath(); ctx.stroke();
    } else {
      ctx.beginPath(); ctx.moveTo(x - 6, y - 6); ctx.lineTo(x + 6, y + 6); ctx.moveTo(x + 6, y - 6); ctx.lineTo(x - 6, y + 6); ctx.stroke();
    }
    ctx.globalAlpha = 1;
  }
}

function drawScale(ctx) {
  const { scale } = view.panels[0];
  const length = niceAbove(70 / scale), width = length * scale;
  const x = 14, y = view.height - 14;
  ctx.fillStyle = theme.stage; ctx.globalAlpha = 0.8;
  ctx.fillRect(x - 6, y - 20, width + 12, 27);
  ctx.globalAlpha = 1; ctx.strokeStyle = theme.ink; ctx.lineWidth = 1.4;
  ctx.beginPath(); ctx.moveTo(x, y - 4); ctx.lineTo(x, y); ctx.lineTo(x + width, y); ctx.lineTo(x + width, y - 4); ctx.stroke();
  ctx.fillStyle = theme.ink; ctx.font = "11.5px system-ui, 'DejaVu Sans', sans-serif"; ctx.textAlign = "center"; ctx.textBaseline = "bottom";
  ctx.fillText(`${length} ${data.unit}`, x + width / 2, y - 3);
}

function everyone(time) {
  const frame = latest(arrays.time, time), present = new Map();
  for (let i = 0; i < data.agents.length; i++) {
    const place = placeOf(i, time, frame);
    if (place) present.set(i, place);
  }
  return present;
}

function draw(canvas) {
  const ctx = canvas.getContext("2d"), dpr = canvas.width / view.width;
  const frame = latest(arrays.time, player.time), present = player.present = everyone(player.time);
  ctx.setTransform(dpr, 0, 0, dpr, 0, 0);
  ctx.fillStyle = theme.stage; ctx.fillRect(0, 0, view.width, view.height);
  const plain = () => ctx.setTransform(dpr, 0, 0, dpr, 0, 0);
  labels.shown = []; labels.agents = []; edgesShown.length = 0;
  drawRoad(ctx, canvas, dpr);
  for (const panel of view.panels) {
    ctx.save();
    plain();
    ctx.beginPath(); ctx.rect(panel.left, panel.top, panel.width, panel.height); ctx.clip();
    drawStops(ctx, panel, dpr, frame);
    plain();
    const seen = inSight(panel, present);
    if (player.layers.graph) drawGraph(ctx, panel, present);
    if (player.layers.paths && futures) for (const { index, place } of seen) drawFutures(ctx, panel, index, colorOf(index, place), true);
    for (const ghost of ghosts.get(frame) || []) drawGhost(ctx, panel, dpr, ghost);
    drawAgents(ctx, panel, dpr, seen);
    plain();
    const chosen = present.get(player.selected), named = player.layers.names && seen.length <= MOST_NAMED;
    labels.begin(panel, seen);
    if (chosen && futures) {
      drawFutures(ctx, panel, player.selected, colorOf(player.selected, chosen), false);
      drawAgent(ctx, panel, dpr, player.selected, chosen, colorOf(player.selected, chosen));
      plain();
    }
    if (named) for (const { index, x, y } of seen) {
      const agent = data.agents[index];
      if (inPanel(panel, [x, y])) labels.place(ctx, panel, x, y, Math.max(agent.width * panel.scale, 6) / 2, agent.name.slice(0, 18));
    } else if (player.layers.names) tag(ctx, panel.left + 8, panel.top + 16, `${seen.length} in sight: zoom in to ${MOST_NAMED} for names`);
    drawEvents(ctx, panel);
    if (panel.label) {
      ctx.fillStyle = theme.muted; ctx.font = "11px system-ui, 'DejaVu Sans', sans-serif"; ctx.textAlign = "left"; ctx.textBaseline = "top";
      ctx.fillText(panel.label, panel.left + 8, panel.top + 3);
    }
    ctx.restore();
  }
  plain();
  drawScale(ctx);
}

function colorOf(index, place) { return MODES[player.mode](index, player.time, place); }
