// Draws the road: what never moves once per view, then the stop lines in their signals' colours.

const TILE = 300;          // shapes are joined by squares of so many metres, and drawn where these are in sight
const DASHES_FROM = 1.2;   // pixels to a metre from which dashes are drawn,
const PAINT_FROM = 0.5;    // and other painted lines,
const LAMPS_FROM = 0.8;    // and signals as lamps; below, their stop lines alone have the colour
const shapes = { tiles: [], tracks: null, picture: null, key: "" };
const SURFACES = ["paving", "asphalt", "bars"], PAINTED = ["dashes", "edges", "middles"];

function addTo(path, points, closed) {
  path.moveTo(points[0], points[1]);
  for (let i = 2; i < points.length; i += 2) path.lineTo(points[i], points[i + 1]);
  if (closed) path.closePath();
}

// Counter-clockwise: surfaces that overlap in one path then fill together and show no seam.
function turnedAlike(points) {
  let area = 0;
  for (let i = 0; i < points.length; i += 2) {
    const j = (i + 2) % points.length;
    area += points[i] * points[j + 1] - points[j] * points[i + 1];
  }
  if (area >= 0) return points;
  const back = [];
  for (let i = points.length - 2; i >= 0; i -= 2) back.push(points[i], points[i + 1]);
  return back;
}

function setUpShapes() {
  if (data.road) setUpTiles();
  else setUpTracks();
}

function setUpTiles() {
  const tiles = new Map();
  for (const kind of [...SURFACES, ...PAINTED]) for (const points of data.road[kind]) {
    let x0 = Infinity, y0 = Infinity, x1 = -Infinity, y1 = -Infinity;
    for (let i = 0; i < points.length; i += 2) {
      x0 = Math.min(x0, points[i]); x1 = Math.max(x1, points[i]);
      y0 = Math.min(y0, points[i + 1]); y1 = Math.max(y1, points[i + 1]);
    }
    const key = `${Math.floor((x0 + x1) / 2 / TILE)} ${Math.floor((y0 + y1) / 2 / TILE)}`;
    if (!tiles.has(key)) tiles.set(key, { box: [Infinity, Infinity, -Infinity, -Infinity], paths: {} });
    const { box, paths } = tiles.get(key), surface = SURFACES.includes(kind);
    tiles.get(key).box = [Math.min(box[0], x0), Math.min(box[1], y0), Math.max(box[2], x1), Math.max(box[3], y1)];
    addTo(paths[kind] ??= new Path2D(), surface ? turnedAlike(points) : points, surface);
  }
  shapes.tiles = [...tiles.values()];
}

// Where no road is known: everyone's way.
function setUpTracks() {
  shapes.tracks = new Path2D();
  for (const agent of data.agents) for (const run of agent.runs) {
    const stride = Math.max(1, Math.floor(run.size / 60));
    shapes.tracks.moveTo(places.x[run.at], places.y[run.at]);
    for (let i = stride; i < run.size; i += stride) shapes.tracks.lineTo(places.x[run.at + i], places.y[run.at + i]);
    shapes.tracks.lineTo(places.x[run.at + run.size - 1], places.y[run.at + run.size - 1]);
  }
}

function inWorld(ctx, { matrix: [a, b, c, d, e, f] }, dpr) {
  ctx.setTransform(a * dpr, b * dpr, c * dpr, d * dpr, e * dpr, f * dpr);
}

function inPixels(panel, [x0, y0, x1, y1]) {
  const [px, py] = toScreen(panel, x0, y0), [qx, qy] = toScreen(panel, x1, y1);
  return [Math.min(px, qx), Math.min(py, qy), Math.max(px, qx), Math.max(py, qy)];
}

function touches(panel, box) {
  const [x0, y0, x1, y1] = inPixels(panel, box);
  return x1 >= panel.left && x0 <= panel.left + panel.width && y1 >= panel.top && y0 <= panel.top + panel.height;
}

// The picture of the road, drawn anew only where the view, its size or the theme is another one.
function drawRoad(ctx, canvas, dpr) {
  const key = JSON.stringify([canvas.width, canvas.height, theme.stage, theme.asphalt, view.panels.map((p) => [p.left, p.top, p.width, p.height, p.matrix])]);
  if (key !== shapes.key) {
    const picture = shapes.picture ??= document.createElement("canvas");
    picture.width = canvas.width; picture.height = canvas.height;
    const own = picture.getContext("2d");
    for (const panel of view.panels) {
      own.save();
      own.setTransform(dpr, 0, 0, dpr, 0, 0);
      own.beginPath(); own.rect(panel.left, panel.top, panel.width, panel.height); own.clip();
      inWorld(own, panel, dpr);
      drawShapes(own, panel);
      own.restore();
    }
    shapes.key = key;
  }
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.drawImage(shapes.picture, 0, 0);
}

function drawShapes(ctx, panel) {
  const pixel = 1 / panel.scale;
  if (!data.road) {
    ctx.strokeStyle = theme.track; ctx.globalAlpha = 0.45; ctx.lineWidth = 1.2 * pixel; ctx.lineJoin = "round";
    ctx.stroke(shapes.tracks);
    ctx.globalAlpha = 1;
    return;
  }
  const seen = shapes.tiles.filter(({ box }) => touches(panel, box));
  const each = (kind, draw) => { for (const { paths } of seen) if (paths[kind]) draw(paths[kind]); };
  const fill = (path) => ctx.fill(path), stroke = (path) => ctx.stroke(path);
  ctx.fillStyle = theme.paving; each("paving", fill);
  ctx.fillStyle = theme.asphalt; each("asphalt", fill);
  ctx.lineWidth = Math.max(0.14, 0.8 * pixel); ctx.strokeStyle = theme.paint; ctx.lineCap = "butt";
  if (panel.scale > DASHES_FROM) each("dashes", stroke);
  if (panel.scale > PAINT_FROM) each("edges", stroke);
  ctx.strokeStyle = theme.middle;
  if (panel.scale > PAINT_FROM) each("middles", stroke);
  ctx.fillStyle = theme.paint; each("bars", fill);
}

const SIGNAL_COLORS = { red: "#d3312b", yellow: "#f2c230", green: "#25a55f", off: "#9aa3ad" };

function signalState(group, frame) {
  const changes = data.signals[group];
  if (!changes) return null;
  const since = firstBeyond(0, changes.length, (i) => changes[i][0] <= frame) - 1;
  return since < 0 ? null : data.signalNames[changes[since][1]];
}

function drawStops(ctx, panel, dpr, frame) {
  if (!data.road) return;
  inWorld(ctx, panel, dpr);
  const pixel = 1 / panel.scale, lines = new Map();
  for (const stop of data.road.stops) {
    const [x0, y0, x1, y1] = stop.line;
    if (!touches(panel, [Math.min(x0, x1) - 3, Math.min(y0, y1) - 3, Math.max(x0, x1) + 3, Math.max(y0, y1) + 3])) continue;
    const state = signalState(stop.signal, frame), color = state ? SIGNAL_COLORS[state] : theme.paint;
    if (panel.scale >= LAMPS_FROM) { drawStop(ctx, stop, state, pixel); continue; }
    if (!lines.has(color)) lines.set(color, new Path2D());
    addTo(lines.get(color), stop.line);
  }
  ctx.lineWidth = 2.4 * pixel;
  for (const [color, path] of lines) { ctx.strokeStyle = color; ctx.stroke(path); }
}

// A stop line in its signal's colour with a lamp behind it whose shape says the same.
function drawStop(ctx, { line }, state, pixel) {
  ctx.strokeStyle = state ? SIGNAL_COLORS[state] : theme.paint;
  ctx.lineWidth = Math.max(0.5, 2 * pixel);
  ctx.beginPath(); ctx.moveTo(line[0], line[1]); ctx.lineTo(line[2], line[3]); ctx.stroke();
  if (!state) return;
  const size = Math.max(0.75, 3.2 * pixel);
  // Ahead of the line, in driving direction: to the left of right-to-left, turned back.
  const dx = line[2] - line[0], dy = line[3] - line[1], long = Math.hypot(dx, dy) || 1;
  const x = (line[0] + line[2]) / 2 + dy / long * size * 1.7, y = (line[1] + line[3]) / 2 - dx / long * size * 1.7;
  ctx.fillStyle = "#11151b";
  ctx.beginPath(); ctx.arc(x, y, size * 1.35, 0, 2 * Math.PI); ctx.fill();
  ctx.fillStyle = SIGNAL_COLORS[state];
  ctx.beginPath();
  if (state === "red") ctx.rect(x - size * 0.7, y - size * 0.7, size * 1.4, size * 1.4);
  else if (state === "yellow") { ctx.moveTo(x, y + size); ctx.lineTo(x + size * 0.87, y - size * 0.5); ctx.lineTo(x - size * 0.87, y - size * 0.5); ctx.closePath(); }
  else ctx.arc(x, y, size * 0.85, 0, 2 * Math.PI);
  ctx.fill();
}
