// What colour an agent has, in each mode.

const MODES = {
  true: (index) => behaviorColor(data.agents[index].truth),
  predicted: (index, time) => behaviorColor(answerTo(beliefOf(index, time))),
  confidence: (index, time) => {
    const belief = beliefOf(index, time);
    return belief ? rampColor((Math.max(...belief) - 1 / 6) * 6 / 5) : data.unknown;
  },
  speed: (index, time, place) => rampColor(place.speed / topSpeed()),
  w: (index, time) => { const w = wOf(index, time); return w ? rampColor(w.share) : data.unknown; },
};

const UNSURE = 0.5;   // below this probability of the likeliest behaviour an outline is dashed

function isUnsure(index) {
  const belief = beliefOf(index, player.time);
  return belief !== null && Math.max(...belief) < UNSURE;
}

function behaviorColor(code) { return code < 0 ? data.unknown : data.behaviors[code].color; }

let fastest = 0;
function topSpeed() {
  if (!fastest) {
    const sorted = Float32Array.from(places.speed).sort();
    fastest = Math.max(1, niceAbove(sorted[Math.floor(0.995 * (sorted.length - 1))]));
  }
  return fastest;
}

function niceAbove(value) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)));
  return [1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10].map((n) => n * power).find((n) => n >= value - 1e-9);
}

const rampCache = [];
function rampColor(share) {
  const slot = Math.round(Math.min(1, Math.max(0, share)) * 64);
  return (rampCache[slot] ??= mixed(slot / 64 * (data.ramp.length - 1)));
}

function mixed(at) {
  const low = Math.min(Math.floor(at), data.ramp.length - 2), share = at - low;
  const part = (stop, i) => parseInt(data.ramp[stop].slice(1 + 2 * i, 3 + 2 * i), 16);
  const hex = (i) => Math.round(part(low, i) + share * (part(low + 1, i) - part(low, i))).toString(16).padStart(2, "0");
  return `#${hex(0)}${hex(1)}${hex(2)}`;
}

const theme = {};
function readTheme() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["paper", "panel", "ink", "muted", "line", "accent", "stage", "asphalt", "paving", "paint", "middle", "outline", "edge", "track", "grave", "hover"]) {
    theme[name] = style.getPropertyValue(`--${name}`).trim();
  }
}

function isDark() {
  const set = document.documentElement.dataset.theme;
  return set ? set === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}
