// The view: from places of the world to pixels, in one panel or in the rows of a folded long road.

const LONG = 4;          // from this ratio of its sides a scene is long: it is turned and folded
const ROW_GAP = 10;      // pixels between rows
const FOOT = 30;         // pixels below them, for the scale

const view = { panels: [], width: 0, height: 0, map: null, turned: false, long: false, busy: null };

function setUpView() {
  const [x0, y0, x1, y1] = data.extent;
  const margin = data.road ? 7 : 0.03 * Math.max(x1 - x0, y1 - y0, 1);
  view.box = [x0 - margin, y0 - margin, x1 + margin, y1 + margin];
  view.turned = y1 - y0 > LONG * (x1 - x0);
  view.long = view.turned || x1 - x0 > LONG * (y1 - y0);
  view.busy = view.long ? null : busyBox();
}

// The box with the middle of all places: where a junction's traffic is.
function busyBox() {
  const middle = (values, low, high) => {
    const sorted = Float64Array.from(values).sort();
    return [sorted[Math.floor(low * (sorted.length - 1))], sorted[Math.floor(high * (sorted.length - 1))]];
  };
  if (!data.road) return view.box;
  const [x0, x1] = middle(places.x, 0.2, 0.8), [y0, y1] = middle(places.y, 0.2, 0.8);
  const cx = (x0 + x1) / 2, cy = (y0 + y1) / 2, half = Math.max(45, (x1 - x0) / 2, (y1 - y0) / 2);
  return [Math.max(view.box[0], cx - half), Math.max(view.box[1], cy - half), Math.min(view.box[2], cx + half), Math.min(view.box[3], cy + half)];
}

// Along and across the screen's width; the world's y points up.
function turnedBox([x0, y0, x1, y1]) { return view.turned ? [y0, -x1, y1, -x0] : [x0, y0, x1, y1]; }
function along(x, y) { return view.turned ? [y, -x] : [x, y]; }

// A panel shows the world around (u, v) in its middle at a scale.
function panel(left, top, width, height, u, v, scale, label = "") {
  const e = left + width / 2 - u * scale, f = top + height / 2 + v * scale;
  const matrix = view.turned ? [0, scale, scale, 0, e, f] : [scale, 0, 0, -scale, e, f];
  return { left, top, width, height, scale, matrix, u, v, label };
}

function layOut() {
  if (view.map) {
    view.panels = [panel(0, 0, view.width, view.height, view.map.u, view.map.v, view.map.scale)];
  } else if (view.long) {
    view.panels = folded();
  } else {
    const [u0, v0, u1, v1] = turnedBox(view.busy);
    const scale = Math.min(view.width / (u1 - u0), view.height / (v1 - v0));
    view.panels = [panel(0, 0, view.width, view.height, (u0 + u1) / 2, (v0 + v1) / 2, scale)];
  }
}

// As many rows as make the road largest.
function folded() {
  const [u0, v0, u1, v1] = turnedBox(view.box);
  let best = null;
  for (let rows = 1; rows <= 10; rows++) {
    const height = (view.height - FOOT - ROW_GAP * (rows - 1)) / rows;
    const scale = Math.min(view.width / ((u1 - u0) / rows), height / (v1 - v0));
    if (height > 12 && (!best || scale > best.scale * 1.02)) best = { rows, height, scale };
  }
  const { rows, height, scale } = best;
  const length = (u1 - u0) / rows;
  return Array.from({ length: rows }, (_, row) => {
    const from = u0 + row * length;
    const label = rows > 1 ? `${Math.max(0, Math.round(from))}–${Math.round(from + length)} ${data.unit}` : "";
    return panel(0, row * (height + ROW_GAP), view.width, height, from + length / 2, (v0 + v1) / 2, scale, label);
  });
}

function toScreen(panel, x, y) {
  const [a, b, c, d, e, f] = panel.matrix;
  return [a * x + c * y + e, b * x + d * y + f];
}

function toWorld(panel, px, py) {
  const [a, b, c, d, e, f] = panel.matrix;
  const det = a * d - b * c;
  return [(d * (px - e) - c * (py - f)) / det, (a * (py - f) - b * (px - e)) / det];
}

function panelAt(px, py) {
  return view.panels.find((p) => px >= p.left && px <= p.left + p.width && py >= p.top && py <= p.top + p.height) || view.panels[0];
}

function zoom(factor, px = view.width / 2, py = view.height / 2) {
  const from = panelAt(px, py);
  const [x, y] = toWorld(from, px, py);
  const scale = Math.min(200, Math.max(0.02, (view.map ? view.map.scale : from.scale) * factor));
  const [u, v] = along(x, y);
  view.map = { scale, u: u - (px - view.width / 2) / scale, v: v + (py - view.height / 2) / scale };
  layOut();
}

function pan(dx, dy) {
  if (!view.map) {
    if (view.panels.length > 1) return;      // all of a folded road is in sight
    view.map = { scale: view.panels[0].scale, u: view.panels[0].u, v: view.panels[0].v };
  }
  view.map.u -= dx / view.map.scale;
  view.map.v += dy / view.map.scale;
  layOut();
}

// The opening view; if that is shown already, everything.
function fit() {
  if (!view.map && !view.long) {
    const [u0, v0, u1, v1] = turnedBox(view.box);
    view.map = { scale: Math.min(view.width / (u1 - u0), view.height / (v1 - v0)), u: (u0 + u1) / 2, v: (v0 + v1) / 2 };
  } else {
    view.map = null;
  }
  layOut();
}

function centreOn(x, y) {
  const [u, v] = along(x, y);
  const scale = view.map ? view.map.scale : Math.max(view.panels[0].scale, Math.min(9, view.width / 90));
  view.map = { scale, u, v };
  layOut();
}
