// The timeline: events and the traits that were shown, each kind of them a row.

const ROW = 15, AXIS = 20, BIN_S = 0.5;
const timeline = { rows: [], height: 0, marks: [], picture: null, key: "", font: "", labels: 0, drawn: [] };

function setUpTimeline() {
  const rows = [];
  if (data.events.length) rows.push({ label: "events", events: data.events });
  data.traits.forEach((trait, code) => {
    const shown = data.shownTraits.filter((x) => x[0] === code && x[1] >= 0);
    if (shown.length) rows.push({ label: trait.name, color: data.behaviors[trait.behavior].color, shown, many: howMany(shown) });
  });
  timeline.rows = rows;
  timeline.height = rows.length * ROW + AXIS;
}

// How many agents show a trait, bin by bin.
function howMany(shown) {
  const bins = new Float32Array(Math.ceil(duration / BIN_S) + 1);
  for (const [, , begin, end] of shown) {
    for (let bin = Math.floor(begin / BIN_S); bin <= Math.min(bins.length - 1, end / BIN_S); bin++) bins[bin]++;
  }
  return bins;
}

function stripFont(width) { return `${width < 560 ? 10.5 : 11.5}px system-ui, 'DejaVu Sans', sans-serif`; }

// The room of the labels: what the widest needs, but at most half of the timeline.
function gutter(width) {
  const font = stripFont(width);
  if (font !== timeline.font) {
    const ctx = strip.getContext("2d");
    ctx.font = timeline.font = font;
    timeline.labels = Math.max(...timeline.rows.map((row) => ctx.measureText(row.label).width));
  }
  return timeline.rows.length ? Math.min(Math.ceil(timeline.labels) + 26, Math.round(width / 2)) : 0;
}

function timelineX(time, width) {
  const left = gutter(width);
  return left + time / duration * (width - left - 6);
}

// All but the line of the present is drawn anew only where it is another timeline.
function drawTimeline(canvas, width) {
  const dpr = canvas.width / width, ctx = canvas.getContext("2d");
  const key = JSON.stringify([canvas.width, canvas.height, width, player.selected, theme.panel, theme.muted]);
  if (key !== timeline.key) {
    const picture = timeline.picture ??= document.createElement("canvas");
    picture.width = canvas.width; picture.height = canvas.height;
    const own = picture.getContext("2d");
    own.setTransform(dpr, 0, 0, dpr, 0, 0);
    drawRows(own, width);
    timeline.key = key;
  }
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.clearRect(0, 0, canvas.width, canvas.height);
  if (timeline.picture.width && timeline.picture.height) ctx.drawImage(timeline.picture, 0, 0);
  ctx.setTransform(dpr, 0, 0, dpr, 0, 0);
  const x = timelineX(player.time, width);
  ctx.strokeStyle = theme.accent; ctx.lineWidth = 2;
  ctx.beginPath(); ctx.moveTo(x, 0); ctx.lineTo(x, timeline.height - AXIS + 4); ctx.stroke();
}

function drawRows(ctx, width) {
  ctx.font = stripFont(width); ctx.textBaseline = "middle";
  timeline.marks = []; timeline.drawn = [];
  const left = gutter(width);
  timeline.rows.forEach((row, i) => {
    const y = i * ROW + ROW / 2;
    if (i % 2) { ctx.fillStyle = theme.panel; ctx.fillRect(left, y - ROW / 2, width - left, ROW); }
    if (row.color) {
      ctx.fillStyle = row.color; ctx.strokeStyle = theme.outline; ctx.lineWidth = 1;
      ctx.beginPath(); ctx.roundRect(1, y - 4, 8, 8, 2); ctx.fill(); ctx.stroke();
    }
    ctx.fillStyle = theme.muted; ctx.textAlign = "left";
    timeline.drawn.push(clipped(ctx, row.label, left - 22));
    ctx.fillText(timeline.drawn[i], 15, y);
    if (row.events) for (const event of row.events) drawEventMark(ctx, event, width, y);
    else drawTraits(ctx, row, width, y);
  });
  drawAxis(ctx, width, left);
}

function clipped(ctx, text, width) {
  if (ctx.measureText(text).width <= width) return text;
  let end = text.length;
  while (end > 1 && ctx.measureText(`${text.slice(0, end)}…`).width > width) end--;
  return `${text.slice(0, end)}…`;
}

function faded(agents) { return player.selected >= 0 && !agents.includes(player.selected); }

// How many show it as a hill over time; of a selected agent, when it does.
function drawTraits(ctx, row, width, y) {
  const most = Math.max(3, ...row.many), foot = y + ROW / 2 - 1;
  ctx.globalAlpha = player.selected >= 0 ? 0.25 : 0.9;
  ctx.fillStyle = row.color;
  ctx.beginPath();
  ctx.moveTo(timelineX(0, width), foot);
  row.many.forEach((count, bin) => {
    const tall = count / most * (ROW - 2);
    ctx.lineTo(timelineX(Math.min(duration, bin * BIN_S), width), foot - tall);
    ctx.lineTo(timelineX(Math.min(duration, (bin + 1) * BIN_S), width), foot - tall);
  });
  ctx.lineTo(timelineX(duration, width), foot);
  ctx.fill();
  ctx.globalAlpha = 1;
  for (const [, agent, begin, end] of row.shown) {
    const x0 = timelineX(begin, width), x1 = Math.max(timelineX(end, width), x0 + 3);
    if (agent === player.selected) {
      ctx.strokeStyle = theme.outline; ctx.lineWidth = 1;
      ctx.beginPath(); ctx.roundRect(x0, y - 4.5, x1 - x0, 9, 2); ctx.fill(); ctx.stroke();
    }
    timeline.marks.push({ x0, x1, y, agent, time: begin, text: () => `${row.label} · ${titleOf(agent)} · ${seconds(begin)} – ${seconds(end)}` });
  }
}

function drawEventMark(ctx, event, width, y) {
  const x = timelineX(event.time, width), grave = data.grave.includes(event.kind);
  ctx.globalAlpha = faded([event.agent, event.other]) ? 0.2 : 1;
  ctx.strokeStyle = ctx.fillStyle = grave ? theme.grave : theme.muted; ctx.lineWidth = 2;
  ctx.beginPath();
  if (event.kind === data.grave[0]) {
    ctx.moveTo(x - 4, y - 4); ctx.lineTo(x + 4, y + 4); ctx.moveTo(x + 4, y - 4); ctx.lineTo(x - 4, y + 4); ctx.stroke();
  } else if (grave) {
    ctx.moveTo(x, y - 5); ctx.lineTo(x + 4.5, y + 4); ctx.lineTo(x - 4.5, y + 4); ctx.closePath(); ctx.stroke();
  } else {
    ctx.arc(x, y, 2.6, 0, 2 * Math.PI); ctx.fill();
  }
  ctx.globalAlpha = 1;
  timeline.marks.push({ x0: x - 5, x1: x + 5, y, agent: event.agent, time: event.time, text: () => eventText(event) });
}

function eventText(event) {
  const who = [event.agent, event.other].filter((i) => i >= 0).map(titleOf).join(", ");
  return `${event.kind} · ${who} · ${seconds(event.time)}`;
}

function drawAxis(ctx, width, left) {
  const step = niceAbove(duration / Math.max(2, Math.floor((width - left) / 90)));
  const y = timeline.height - AXIS;
  ctx.strokeStyle = theme.line; ctx.lineWidth = 1; ctx.fillStyle = theme.muted; ctx.textAlign = "center";
  ctx.beginPath(); ctx.moveTo(left, y + 0.5); ctx.lineTo(width, y + 0.5);
  const first = Math.ceil(data.begin / step - 1e-6) * step;
  for (let shown = first; shown <= data.begin + duration + 1e-6; shown += step) {
    const x = timelineX(shown - data.begin, width);
    ctx.moveTo(x, y); ctx.lineTo(x, y + 4);
    const text = `${+shown.toFixed(3)} s`, half = ctx.measureText(text).width / 2;
    ctx.fillText(text, Math.min(width - half - 1, Math.max(half + 1, x)), y + 12);
  }
  ctx.stroke();
}

function markAt(px, py) {
  let best = null;
  for (const mark of timeline.marks) {
    if (Math.abs(mark.y - py) > ROW / 2 || px < mark.x0 - 2 || px > mark.x1 + 2) continue;
    if (!best || mark.agent === player.selected || (best.agent !== player.selected && mark.x1 - mark.x0 < best.x1 - best.x0)) best = mark;
  }
  return best;
}
