// The page of `activefail explore`: sends the design to the server and shows its answers.

import { about, ask, find, latest, share, showDrawing, sliders, withSubscripts } from "./common.js";

const variables = about.variables;
const point = about.presets[0].point.slice();

// --- the design ----------------------------------------------------------------------------------------------------

const column = (name) => variables.findIndex((v) => v.name === name);

function showPoint() {
  show();
  placeMarker();
}

function moved(changed) {
  // A changed design is not a preset: deselect it, so that it can be selected again.
  if (changed) find("preset").value = "";
  if (about.simulates) find("earlier").hidden = find("outcome").textContent === "";
  showPoint();
  predict();
  // The plane does not depend on its own two variables.
  if (!changed || changed.some((i) => !planeColumns().includes(i))) plane();
  fragility();
}

const { show, set, setComputed } = sliders(variables, point, moved);

// --- prediction ----------------------------------------------------------------------------------------------------

function bar(text, value, interval) {
  const row = document.createElement("div");
  row.className = interval ? "bar interval" : "bar";
  const name = document.createElement("span");
  name.textContent = text;
  const track = document.createElement("span");
  track.className = "track";
  track.setAttribute("aria-hidden", "true");
  const number = document.createElement("span");
  number.className = "value";
  number.textContent = value;
  row.append(name, track, number);
  return { row, track };
}

const predict = latest(async () => {
  const answer = await ask("predict", { point });
  const bars = answer.probabilities.map((p, i) => {
    const { row, track } = bar(about.outcomes[i].text, share(p));
    const fill = document.createElement("span");
    fill.className = "fill";
    fill.style.width = `${100 * p}%`;
    fill.style.background = about.outcomes[i].colour;
    track.append(fill);
    row.dataset.outcome = about.outcomes[i].name;
    row.dataset.probability = p;
    return row;
  });
  find("probabilities").replaceChildren(...bars);
  const intervals = answer.boundaries.map((b) => {
    const { row, track } = bar(b.text, `${share(b.probability)} (${share(b.low)} to ${share(b.high)})`, true);
    const range = document.createElement("span");
    range.className = "range";
    range.style.left = `${100 * b.low}%`;
    range.style.right = `${100 * (1 - b.high)}%`;
    const dot = document.createElement("span");
    dot.className = "dot";
    dot.style.left = `${100 * b.probability}%`;
    track.append(range, dot);
    return row;
  });
  find("boundaries").replaceChildren(...intervals);
  const target = answer.boundaries.find((b) => b.text === about.beyond);
  if (target) {
    find("verdict").textContent = share(target.probability);
    find("verdict-interval").textContent = `(${share(target.low)} to ${share(target.high)}: the classifier's 95 % interval)`;
  }
  find("absent").textContent = answer.absent;
}, "result");

// --- the plane -----------------------------------------------------------------------------------------------------

const hasPlane = find("plane") !== null;
let axes = null;
const planeColumns = () => (hasPlane ? [column(find("plane-x").value), column(find("plane-y").value)] : []);

const plane = latest(async () => {
  if (!hasPlane) return;
  const [x, y] = [find("plane-x").value, find("plane-y").value];
  const answer = await ask("plane", { point, x, y, shown: find("plane-shown").value });
  showDrawing(find("plane").querySelector(".drawing"), answer.svg);
  axes = answer.axes;
  placeMarker();
}, "plane");

function placeMarker() {
  if (!axes) return;
  const [x, y] = planeColumns();
  const at = (i) => (point[i] - variables[i].low) / (variables[i].high - variables[i].low);
  find("marker").style.left = `${100 * (axes.left + at(x) * (axes.right - axes.left))}%`;
  find("marker").style.top = `${100 * (axes.bottom - at(y) * (axes.bottom - axes.top))}%`;
}

function clickPlane(event) {
  if (!axes) return;
  const box = find("plane").querySelector("svg").getBoundingClientRect();
  const across = ((event.clientX - box.left) / box.width - axes.left) / (axes.right - axes.left);
  const up = (axes.bottom - (event.clientY - box.top) / box.height) / (axes.bottom - axes.top);
  if (across < -0.02 || across > 1.02 || up < -0.02 || up > 1.02) return;
  const [x, y] = planeColumns();
  setComputed(x, variables[x].low + across * (variables[x].high - variables[x].low));
  setComputed(y, variables[y].low + up * (variables[y].high - variables[y].low));
  moved([x, y]);
}

function keyOnPlane(event) {
  const [x, y] = planeColumns();
  const step = { ArrowLeft: [x, -1], ArrowRight: [x, 1], ArrowDown: [y, -1], ArrowUp: [y, 1] }[event.key];
  if (!step) return;
  event.preventDefault();
  const [i, sign] = step;
  const share = (event.shiftKey ? 0.1 : 0.02) * (variables[i].high - variables[i].low);
  setComputed(i, point[i] + sign * Math.max(share, variables[i].step || 0));
  moved([i]);
}

// --- fragility -----------------------------------------------------------------------------------------------------

const fragility = latest(async () => {
  if (!find("along")) return;
  const answer = await ask("fragility", { point, along: find("along").value });
  showDrawing(find("fragility"), answer.svg);
}, "fragility");

// --- what the campaign learned -------------------------------------------------------------------------------------

const history = latest(async () => {
  const { svg } = await ask("curve", {});
  if (svg) showDrawing(find("history").querySelector(".drawing"), svg);
  else find("history").remove();
}, "history");

const failure = latest(async () => {
  const { html, preset } = await ask("failure", {}).catch((error) => {
    find("failure").firstElementChild.textContent = `No answer: ${error.message}`;
    throw error;
  });
  if (preset) {
    about.presets.push(preset);
    find("preset").add(new Option(preset.text, about.presets.length - 1), find("preset").length - 1);
  }
  if (!html) return find("failure").remove();
  find("failure").replaceChildren(...new DOMParser().parseFromString(html, "text/html").body.childNodes);
  find("failure").setAttribute("aria-labelledby", "h-probability");
}, "failure");

// --- simulation ----------------------------------------------------------------------------------------------------

const SVG = "http://www.w3.org/2000/svg";
function element(name, attributes, parent, text) {
  const node = document.createElementNS(SVG, name);
  Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
  if (text !== undefined) node.textContent = text;
  if (parent) parent.append(node);
  return node;
}
const outline = (rows) => rows.map((row) => row.join(",")).join(" ");
const MARKS = [
  { fill: "#000", shape: "circle" },
  { fill: "#d55e00", shape: "square" },
  { fill: "#f0e442", shape: "diamond" },
  { fill: "#fff", shape: "circle" },
];
let film = null;
let playing = null;

function buildStage(answer) {
  const stage = find("stage");
  const [left, low] = answer.low;
  const [right, high] = answer.high;
  stage.setAttribute("viewBox", `${left} ${-high} ${right - left} ${high - low}`);
  stage.replaceChildren();
  const line = 0.003 * (right - left);
  const world = element("g", { transform: "scale(1,-1)" }, stage);
  const steel = { fill: "#d5dae1", stroke: "#6b7280", "stroke-width": line };
  const ring = { fill: "#6b7280", stroke: "#6b7280", "stroke-width": line };
  const plate = (parent) => {
    element("polygon", { points: outline(answer.plate), ...steel }, parent);
    return answer.rims.map((rim) => element("polygon", { points: outline(rim), ...ring }, parent));
  };
  const rims = [plate(element("g", { id: "bottom-plate" }, world))];
  const top = element("g", { id: "top-plate", opacity: 0.85 }, world);
  rims.push(plate(top));
  const slider = element("g", { id: "slider" }, world);
  element("polygon", { points: outline(answer.slider), fill: "#56b4e9", stroke: "#0072b2", "stroke-width": line, opacity: 0.9 }, slider);
  const half = Math.max(...answer.slider.map((row) => row[1]));
  element("line", { x1: 0, x2: 0, y1: -half, y2: half, stroke: "#0072b2", "stroke-width": line, "stroke-dasharray": `${4 * line} ${2 * line}` }, slider);
  const marks = [0, 1, 2, 3].map(() => element("path", { stroke: "#000", "stroke-width": 0.7 * line }, world));
  const arrow = element("path", { fill: "none", stroke: "#cc79a7", "stroke-width": 3 * line }, world);
  const size = 0.022 * (right - left);
  element("text", { x: 0, y: -(low + 0.6 * size), "font-size": 1.25 * size, "text-anchor": "middle", fill: "#8f3f6a" }, stage, "ground acceleration");
  // A scale bar, since the drawing has no axes, on the side with more room.
  const ruler = [0.5, 0.2, 0.1].find((length) => length < 0.15 * (right - left)) || 0.05;
  const x0 = -left > right ? left + size : right - 5 * size - ruler;
  const foot = -(low + size);
  element("path", { d: `M${x0},${foot - 0.5 * size}v${size}v${-0.5 * size}h${ruler}v${-0.5 * size}v${size}`, fill: "none", stroke: "#1b2430", "stroke-width": line }, stage);
  element("text", { id: "ruler", x: x0 + ruler + 0.5 * size, y: -(low + 0.6 * size), "font-size": 1.25 * size, fill: "#1b2430" }, stage, `${ruler} m`);
  const peak = Math.max(...answer.frames.ground.map(Math.abs), 1e-12);
  return { rims, top, slider, marks, arrow, line, peak, reach: 0.3 * (right - left), base: low + 2.1 * size };
}

function markPath(shape, [x, z], r) {
  if (shape === "square") return `M${x - r},${z - r}h${2 * r}v${2 * r}h${-2 * r}Z`;
  if (shape === "diamond") return `M${x - 1.3 * r},${z}L${x},${z + 1.3 * r}L${x + 1.3 * r},${z}L${x},${z - 1.3 * r}Z`;
  return `M${x - r},${z}a${r},${r} 0 1 0 ${2 * r},0a${r},${r} 0 1 0 ${-2 * r},0Z`;
}

const histories = latest(async () => {
  const shown = film;
  // A narrower figure keeps its text legible on a phone.
  const answer = await ask("histories", { point: shown.point, narrow: window.innerWidth < 740 });
  // If the film was replaced meanwhile, the new one makes its own request.
  if (film !== shown) return;
  showDrawing(find("histories").querySelector(".drawing"), answer.svg);
  film.histories = answer;
  const { top, bottom } = answer.axes;
  Object.assign(find("cursor").style, { top: `${100 * top}%`, height: `${100 * (bottom - top)}%` });
  showCursor();
});

function showCursor() {
  find("cursor").hidden = !film.histories;
  if (!film.histories) return;
  const { axes, times } = film.histories;
  const along = (film.answer.frames.t[Number(find("time").value)] - times[0]) / (times[1] - times[0]);
  find("cursor").style.left = `${100 * (axes.left + along * (axes.right - axes.left))}%`;
}

function showFrame(k) {
  const { frames } = film.answer;
  const [xs, zs, theta, xt, zt] = frames.q[k];
  const { stage } = film;
  stage.top.setAttribute("transform", `translate(${xt},${zt}) scale(1,-1)`);
  stage.slider.setAttribute("transform", `translate(${xs},${zs}) rotate(${(theta * 180) / Math.PI})`);
  // A rim that yields moves outwards; of a broken one the outline is left.
  stage.rims.forEach((pair, plate) => pair.forEach((rim, side) => {
    const arc = frames.arcs[k][2 * plate + side];
    rim.setAttribute("transform", `translate(${(2 * side - 1) * (arc || 0)},0)`);
    const broken = arc === null;
    rim.setAttribute("fill", broken ? "none" : "#6b7280");
    rim.setAttribute("stroke", broken ? "#d55e00" : "#6b7280");
    rim.setAttribute("stroke-dasharray", broken ? `${3 * stage.line}` : "none");
  }));
  stage.marks.forEach((mark, i) => {
    const look = MARKS[frames.states[k][i]];
    mark.setAttribute("d", markPath(look.shape, frames.vertices[k][i], 3 * stage.line));
    mark.setAttribute("fill", look.fill);
  });
  const length = (frames.ground[k] / stage.peak) * stage.reach;
  const head = Math.sign(length) * Math.min(Math.abs(length), 8 * stage.line);
  stage.arrow.setAttribute("d", `M0,${stage.base}H${length}M${length - head},${stage.base + Math.abs(head) / 2}L${length},${stage.base}L${length - head},${stage.base - Math.abs(head) / 2}`);
  find("time").value = k;
  showCursor();
  const text = `t = ${frames.t[k].toFixed(2)} s`.replace("-", "−");
  find("clock").textContent = text;
  find("time").setAttribute("aria-valuetext", text);
}

function stop() {
  if (playing !== null) cancelAnimationFrame(playing);
  playing = null;
  find("play").textContent = "Play";
}

function play() {
  const { t } = film.answer.frames;
  const last = t.length - 1;
  const from = Number(find("time").value) >= last ? 0 : Number(find("time").value);
  const start = performance.now();
  find("play").textContent = "Pause";
  const tick = (now) => {
    // In real time; a motion of more than ten seconds is sped up to ten.
    const speed = Math.max(1, (t[last] - t[0]) / 10);
    const time = t[from] + (Math.max(0, now - start) / 1000) * speed;
    const k = Math.min(last, Math.round((last * (time - t[0])) / (t[last] - t[0])));
    showFrame(k);
    if (k >= last) stop();
    else playing = requestAnimationFrame(tick);
  };
  playing = requestAnimationFrame(tick);
}

const simulate = latest(async () => {
  const design = point.slice();
  const answer = await ask("simulate", { point: design });
  stop();
  find("outcome").textContent = answer.description;
  find("outcome").dataset.outcome = answer.outcome;
  find("earlier").hidden = true;
  find("command").textContent = answer.command;
  find("terms").replaceChildren(withSubscripts(answer.terms));
  find("film").hidden = !answer.frames;
  if (!answer.frames) return;
  film = { answer, point: design, stage: buildStage(answer), histories: null };
  find("histories").querySelector(".drawing").replaceChildren();
  find("time").max = answer.frames.t.length - 1;
  showFrame(0);
  histories();
  find("stage").scrollIntoView({ block: "nearest" });
  if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) play();
}, "motion");

// --- start ---------------------------------------------------------------------------------------------------------

document.querySelectorAll("[data-subscript]").forEach((place) => place.replaceChildren(withSubscripts(place.textContent)));
find("preset").addEventListener("change", (event) => {
  about.presets[Number(event.target.value)].point.forEach((value, i) => set(i, value));
  moved();
});
if (hasPlane) {
  find("plane-x").value = about.plane[0];
  find("plane-y").value = about.plane[1];
  find("plane").addEventListener("click", clickPlane);
  find("plane").addEventListener("keydown", keyOnPlane);
  ["plane-x", "plane-y"].forEach((id, axis) => {
    let previous = find(id).value;
    find(id).addEventListener("change", () => {
      const other = find(["plane-y", "plane-x"][axis]);
      // A plane needs two variables: if both are the same, swap them.
      if (other.value === find(id).value) other.value = previous;
      other.dispatchEvent(new Event("swapped"));
      previous = find(id).value;
      plane();
    });
    find(id).addEventListener("swapped", () => (previous = find(id).value));
  });
  find("plane-shown").addEventListener("change", plane);
}
if (find("along")) {
  find("along").value = about.along;
  find("along").addEventListener("change", fragility);
}
if (about.simulates) {
  find("simulate").addEventListener("click", simulate);
  find("play").addEventListener("click", () => (playing === null ? play() : stop()));
  find("time").addEventListener("input", (event) => {
    stop();
    showFrame(Number(event.target.value));
  });
}
showPoint();
await Promise.all([predict(), plane(), fragility()]);
history();
failure();
