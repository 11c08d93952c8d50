// What all pages do: a page is a form, and the server makes each of its panels from the form's values.

const form = document.querySelector("form");
const panels = [...document.querySelectorAll("[data-panel]")];

// --- fields --------------------------------------------------------------------------------------------------------

// A slider and the number beside it: the number is what the form sends.
const beside = (input, css) => input.closest(".slider")?.querySelector(css);

// What a start fills in, by field: a field shows six digits of a number, and the form sends them all.
const exact = new Map();

// A number in a form that can be typed in again; with more digits if six lie outside the field's range.
function plain(value, { min, max }) {
  const short = Number(Number(value).toPrecision(6));
  if (short < min || short > max) return String(value);
  const size = Math.abs(short);
  return size !== 0 && (size < 1e-3 || size >= 1e6) ? short.toExponential().replace("e+", "e") : String(short);
}

const isNumber = (field) => field.type === "number";
const shownAs = (field, value) => (isNumber(field) ? plain(value, field) : String(value));

function fill(values) {
  for (const [name, value] of Object.entries(values)) {
    const field = form.elements[name];
    field.value = shownAs(field, value);
    exact.set(name, value);
    const range = beside(field, "[type=range]");
    if (range) range.value = value;
  }
}

// The form as an object: what is shown is sent with all its digits.
function sent() {
  const values = form ? Object.fromEntries(new FormData(form)) : {};
  for (const [name, value] of exact) if (values[name] === shownAs(form.elements[name], value)) values[name] = value;
  return values;
}

// Moves a field to a share of its range; the slider rounds it.
function moveTo(name, share) {
  const number = form.elements[name];
  const range = beside(number, "[type=range]");
  range.value = Number(number.min) + share * (number.max - number.min);
  number.value = plain(range.value, number);
}

function shareOf(name) {
  const { value, min, max } = form.elements[name];
  return (value - min) / (max - min);
}

// --- panels --------------------------------------------------------------------------------------------------------

const asked = new Map();
const shown = new Map();
const timers = new Map();

// Asks for a panel. One request of a panel runs at a time; of those made meanwhile only the last runs.
async function refresh(panel, more = {}) {
  const isBusy = asked.has(panel);
  asked.set(panel, more);
  if (isBusy) return;
  panel.setAttribute("aria-busy", "true");
  while (asked.get(panel)) {
    const body = JSON.stringify({ ...sent(), ...asked.get(panel) });
    asked.set(panel, null);
    // A field in which a visitor is still typing may be empty.
    if (form && !form.checkValidity()) continue;
    try {
      const response = await fetch(`api/${panel.id}`, { method: "POST", headers: { "Content-Type": "application/json" }, body });
      if (!response.ok) throw new Error((await response.json()).error);
      show(panel, await response.text());
    } catch (error) {
      const fault = Object.assign(document.createElement("p"), { className: "fault", role: "alert", textContent: `No answer: ${error.message}` });
      panel.querySelector(":scope > .fault")?.remove();
      panel.prepend(fault);
      shown.delete(panel);
    }
  }
  asked.delete(panel);
  panel.setAttribute("aria-busy", "false");
  again(panel);
}

function show(panel, html) {
  if (!html.trim()) return panel.closest("section").remove();
  delete panel.dataset.stale;
  if (shown.get(panel) !== html) {
    const focused = panel.contains(document.activeElement) && document.activeElement.id;
    const isOpen = panel.querySelector("details")?.open;
    panel.replaceChildren(...new DOMParser().parseFromString(html, "text/html").body.childNodes);
    if (focused) document.getElementById(focused)?.focus();
    if (isOpen) panel.querySelector("details")?.setAttribute("open", "");
    shown.set(panel, html);
    mark(panel);
    if (panel.querySelector(".film")) play(panel.querySelector(".film"));
  }
}

// Asks for a panel after the time that it states.
function again(panel) {
  const after = panel.querySelector("[data-again]")?.dataset.again;
  clearTimeout(timers.get(panel));
  if (after) timers.set(panel, setTimeout(() => (document.hidden ? again(panel) : refresh(panel)), after));
}

// Asks for the panels that depend on changed fields: those of the same section, else all.
async function changed(names, section = null) {
  const values = sent();
  for (const presets of form.querySelectorAll("select[data-fills]")) {
    const filled = presets.value ? JSON.parse(presets.value) : {};
    if (names.some((name) => name in filled && Number(values[name]) !== filled[name])) presets.value = "";
  }
  const later = panels.filter((one) => one.isConnected && (!section || section.contains(one))).map((panel) => {
    mark(panel);
    if (panel.dataset.panel === "button") panel.dataset.stale = "";
    // A plane does not depend on its own two variables.
    const own = axesIn(panel) ?? [];
    return panel.dataset.panel === "form" && !names.every((name) => own.includes(name)) ? refresh(panel) : null;
  });
  await Promise.all(later);
}

// --- the plane -----------------------------------------------------------------------------------------------------

const axesIn = (panel) => panel.querySelector("[data-axes]")?.dataset.axes.split(" ");

// Tells a panel's drawing where the design is on its axes.
function mark(panel) {
  const style = panel.querySelector("[data-axes] > .drawing")?.style;
  axesIn(panel)?.forEach((name, axis) => style.setProperty(["--x", "--y"][axis], shareOf(name)));
}

function clicked(event) {
  const drawing = event.target.closest("[data-axes] > .drawing");
  if (!drawing) return;
  const box = drawing.getBoundingClientRect();
  const [left, right, top, bottom] = ["left", "right", "top", "bottom"].map((side) => Number(drawing.style.getPropertyValue(`--${side}`)));
  const across = ((event.clientX - box.left) / box.width - left) / (right - left);
  const up = (bottom - (event.clientY - box.top) / box.height) / (bottom - top);
  if (Math.min(across, up) < -0.02 || Math.max(across, up) > 1.02) return;
  const [x, y] = drawing.parentElement.dataset.axes.split(" ");
  moveTo(x, across);
  moveTo(y, up);
  changed([x, y]);
}

// Says to a screen reader where a plane's mark is, and what is predicted there.
function say(panel) {
  const at = axesIn(panel).map((name) => {
    const number = form.elements[name];
    return `${number.labels[0].querySelector("b").textContent} ${number.value} ${beside(number, ".unit").textContent}`;
  });
  const predicted = document.querySelector("#predict .card, #predict .fault")?.textContent;
  panel.querySelector("[role=status]").textContent = [...at, predicted].join(", ");
}

async function pressed(event) {
  const axes = event.target.matches("[data-panel]") && axesIn(event.target);
  const [axis, sign] = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1] }[event.key] ?? [];
  if (!axes || sign === undefined) return;
  event.preventDefault();
  const { step, min, max } = form.elements[axes[axis]];
  moveTo(axes[axis], shareOf(axes[axis]) + sign * Math.max(event.shiftKey ? 0.1 : 0.02, (Number(step) || 0) / (max - min)));
  await changed([axes[axis]]);
  say(event.target);
}

// --- a film --------------------------------------------------------------------------------------------------------

function play(film) {
  const svg = film.querySelector(".stage");
  const [button, time, clock] = ["play", "time", "clock"].map((id) => document.getElementById(id));
  const length = parseFloat(svg.querySelector("[dur]").getAttribute("dur"));
  const { first, last } = film.dataset;
  const isOver = () => svg.getCurrentTime() >= length;
  const toggle = (plays) => {
    if (plays) svg.unpauseAnimations();
    else svg.pauseAnimations();
    button.textContent = plays ? "Pause" : "Play";
    tick();
  };
  const tick = () => {
    if (!svg.isConnected) return;
    const share = Math.min(1, svg.getCurrentTime() / length);
    time.value = share;
    film.style.setProperty("--x", share);
    clock.textContent = `t = ${(Number(first) + share * (last - first)).toFixed(2)} s`.replace("-", "−");
    time.setAttribute("aria-valuetext", clock.textContent);
    if (svg.animationsPaused()) return;
    if (isOver()) toggle(false);
    else requestAnimationFrame(tick);
  };
  button.addEventListener("click", () => {
    if (isOver()) svg.setCurrentTime(0);
    toggle(svg.animationsPaused());
  });
  time.addEventListener("input", () => {
    const share = Number(time.value);
    svg.setCurrentTime(share * length);
    toggle(false);
  });
  svg.setCurrentTime(0);
  film.scrollIntoView({ block: "nearest" });
  toggle(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
}

// --- what a visitor does -------------------------------------------------------------------------------------------

form?.addEventListener("input", ({ target }) => {
  const number = target.type === "range" && beside(target, "[name]");
  if (!number) return;
  number.value = plain(target.value, number);
  changed([number.name]);
});

form?.addEventListener("change", ({ target }) => {
  if (target.hasAttribute("data-fills")) {
    fill(JSON.parse(target.value));
    changed(Object.keys(JSON.parse(target.value)));
  } else if (target.name && target.reportValidity()) {
    const range = beside(target, "[type=range]");
    if (range) range.value = target.value;
    // A plane needs two variables: if both are the same, they are exchanged.
    const other = { across: "up", up: "across" }[target.name];
    if (other && form.elements[other].value === target.value) form.elements[other].value = axesIn(target.closest("section"))[other === "up" ? 0 : 1];
    const section = target.closest("section");
    changed([target.name], section.querySelector("[data-panel]") && section);
  }
});

form?.addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (button?.hasAttribute("data-fills")) {
    fill(JSON.parse(button.value));
    changed(Object.keys(JSON.parse(button.value)));
  } else if (button?.name && form.reportValidity()) refresh(button.closest("section").querySelector("[data-panel]"), { do: button.value });
  else clicked(event);
});

form?.addEventListener("keydown", pressed);
form?.addEventListener("submit", (event) => event.preventDefault());

// Opening a campaign for the first time takes a few seconds. A new tab opens it elsewhere.
document.addEventListener("click", (event) => {
  if (event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.target.closest("tr a")?.closest("tr").setAttribute("aria-busy", "true");
});

for (const number of document.querySelectorAll("input[type=number]")) fill({ [number.name]: number.defaultValue });
// First what answers at once.
for (const panel of panels) again(panel);
await Promise.all(panels.filter((panel) => panel.dataset.panel === "form").map((panel) => refresh(panel)));
for (const panel of panels.filter((one) => one.dataset.panel === "once")) refresh(panel);
