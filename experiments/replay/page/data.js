// The data: read back from what page.py wrote.

const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);

async function inflated(base64) {
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

const TYPES = { Uint8: Uint8Array, Uint16: Uint16Array, Int32: Int32Array, Float32: Float32Array };

async function readArrays() {
  const buffer = await inflated(data.packed);
  const arrays = {};
  for (const [name, [type, offset, count]] of Object.entries(data.index)) {
    arrays[name] = new TYPES[type](buffer, offset, count);
  }
  delete data.packed;
  return arrays;
}

// The values of an array that was written as differences, so many of them side by side.
function summed(differences, unit, stride = 1) {
  const values = new Float64Array(differences.length);
  const sums = new Array(stride).fill(0);
  for (let i = 0; i < values.length; i++) values[i] = unit * (sums[i % stride] += differences[i]);
  return values;
}

// Places of every agent as runs of frames without a gap.
function readPlaces(arrays) {
  for (const agent of data.agents) agent.runs = [];
  let at = 0;
  arrays.runAgent.forEach((agent, run) => {
    data.agents[agent].runs.push({ begin: arrays.runStep[run], size: arrays.runSize[run], at });
    at += arrays.runSize[run];
  });
  const values = (name) => summed(arrays[name], data.units[name]);
  return { x: values("x"), y: values("y"), heading: values("heading"), speed: values("speed") };
}

// Possible futures: index of the places of future m is m * H.
function readFutures(arrays) {
  if (!data.ahead.length) return null;
  const xy = summed(arrays.future, data.units.future, 2);
  return { xy, ahead: data.ahead, agent: arrays.futureAgent, probability: arrays.futureProbability, time: arrays.forecastTime, begin: arrays.forecastBegin, stale: Math.max(2.1, 1.1 * (arrays.forecastTime[1] - arrays.forecastTime[0] || 0)) };
}

// By frame, where everyone factually was who is elsewhere now: of a counterfactual episode.
function readGhosts(arrays) {
  const found = new Map();
  if (!data.ghosts.length) return found;
  const xy = summed(arrays.ghostXY, data.units.x, 2);
  for (let i = 0; i < arrays.ghostOf.length; i++) {
    const place = { ...data.ghosts[arrays.ghostOf[i]], heading: arrays.ghostHeading[i], x: xy[2 * i], y: xy[2 * i + 1] };
    if (!found.has(arrays.ghostStep[i])) found.set(arrays.ghostStep[i], []);
    found.get(arrays.ghostStep[i]).push(place);
  }
  return found;
}

// Index of the last entry that is not after the time; -1 if all are.
function latest(times, time) {
  return firstBeyond(0, times.length, (i) => times[i] <= time + 1e-4) - 1;
}

// The first index from low on for which something holds no more; high if it holds for all.
function firstBeyond(low, high, holds) {
  while (low < high) {
    const middle = (low + high) >> 1;
    if (holds(middle)) low = middle + 1; else high = middle;
  }
  return low;
}

let arrays, places, futures, ghosts, duration;

// Where an agent is at a time, between two frames on the straight line; null if it is not there.
function placeOf(index, time, frame = latest(arrays.time, time)) {
  for (const run of data.agents[index].runs) {
    const into = frame - run.begin;
    if (into < 0 || into >= run.size) continue;
    const at = run.at + into;
    const here = arrays.time[frame];
    if (into + 1 >= run.size) {
      return time - here < 0.12 ? { x: places.x[at], y: places.y[at], heading: places.heading[at], speed: places.speed[at] } : null;
    }
    const share = Math.min(1, Math.max(0, (time - here) / (arrays.time[frame + 1] - here)));
    const between = (values) => values[at] + share * (values[at + 1] - values[at]);
    return { x: between(places.x), y: between(places.y), heading: between(places.heading), speed: between(places.speed) };
  }
  return null;
}

// When an agent is first and last seen.
function lifeOf(index) {
  const runs = data.agents[index].runs;
  const last = runs[runs.length - 1];
  return [arrays.time[runs[0].begin], arrays.time[last.begin + last.size - 1]];
}

// The six probabilities at a look, or null.
function beliefAt(index, look) {
  const from = (index * arrays.beliefTime.length + look) * data.behaviors.length;
  const row = arrays.belief.subarray(from, from + data.behaviors.length);
  let sum = 0;
  for (const p of row) sum += p;
  return look < 0 || !sum ? null : Array.from(row, (p) => p / sum);
}

function beliefOf(index, time) {
  return beliefAt(index, latest(arrays.beliefTime, time));
}

function mostLikely(belief) {
  return belief ? belief.indexOf(Math.max(...belief)) : -1;
}

// Whether an answer is earned: the style or the behaviour is likely enough.
function isLabelled(belief) {
  if (!belief) return false;
  let aggressive = 0;
  belief.forEach((p, code) => { if (data.behaviors[code].style === "aggressive") aggressive += p; });
  return Math.max(aggressive, 1 - aggressive) >= data.labelled.style;
}

// The likeliest behaviour where an answer is earned, or -1.
function answerTo(belief) { return isLabelled(belief) ? mostLikely(belief) : -1; }

// The root of an agent's share of the largest |w|, and |w| itself; null if it is not there.
function wOf(index, time) {
  const look = latest(arrays.graphTime, time);
  const root = look < 0 ? 255 : arrays.w[index * arrays.graphTime.length + look];
  return root === 255 ? null : { share: root / 254, value: (root / 254) ** 2 * arrays.wLargest[look] };
}

// The futures of an agent as last predicted, or null.
function futuresOf(index, time) {
  if (!futures) return null;
  const instant = latest(futures.time, time);
  if (instant < 0) return null;
  const found = [], end = futures.begin[instant + 1];
  // Agents ascend, so those of one are together.
  const first = firstBeyond(futures.begin[instant], end, (m) => futures.agent[m] < index);
  for (let m = first; m < end && futures.agent[m] === index; m++) found.push(m);
  return found.length && time - futures.time[instant] < futures.stale ? { time: futures.time[instant], futures: found } : null;
}

function seconds(time) { return `${(data.begin + time).toFixed(1)} s`; }

function titleOf(index) {
  const agent = data.agents[index];
  return `${data.kinds[agent.kind]} ${agent.name}`;
}
