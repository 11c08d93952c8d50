// What the explorer's pages share: text and numbers, what a moved slider does, requests, and drawings.

export const about = JSON.parse(document.getElementById("about").textContent);
export const find = (id) => document.getElementById(id);

// --- text and numbers ----------------------------------------------------------------------------------------------

export function withSubscripts(text) {
  const span = document.createElement("span");
  text.split(/(_[A-Za-z0-9]+)/).forEach((part) => {
    if (part.startsWith("_")) {
      const sub = document.createElement("sub");
      sub.textContent = part.slice(1);
      span.append(sub);
    } else span.append(part);
  });
  return span;
}

function power(value, digits) {
  const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
  const raised = [...String(Number(exponent))].map((c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("");
  return `${mantissa}·10${raised}`.replace(/^-/, "−");
}

export function number(value) {
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return power(value, 3);
  return (size === 0 ? "0" : Number(value.toPrecision(3)).toString()).replace(/^-/, "−");
}

// In a form that can be typed in again.
export function plain(value) {
  const size = Math.abs(value);
  const short = Number(value.toPrecision(6));
  return size !== 0 && (size < 1e-3 || size >= 1e6) ? short.toExponential().replace("e+", "e") : short.toString();
}

// A probability: a power of ten below 0.01, its nines, up to six, above 0.99.
export function share(p) {
  const rest = 1 - p;
  if (p < 1e-6) return "< 10⁻⁶";
  if (rest < 1e-6) return "> 0.999999";
  return p < 0.01 ? power(p, 2) : p.toFixed(rest < 0.01 ? Math.min(6, 1 - Math.floor(Math.log10(rest))) : 2);
}

// --- fields --------------------------------------------------------------------------------------------------------

// Marks a field as invalid and says why below it; without a reason, takes both away.
export function refuse(field, reason = "") {
  const id = `${field.id}-fault`;
  field.setAttribute("aria-invalid", String(reason !== ""));
  if (!reason) return find(id)?.remove();
  const place = find(id) || document.createElement("p");
  Object.assign(place, { id, className: "fault", role: "alert", textContent: reason });
  field.closest(".entry").after(place);
}

// --- sliders -------------------------------------------------------------------------------------------------------

const STEPS = 1000;

// Sliders v0, v1, … with number fields t0, t1, … for some quantities. `values` is changed in place; `moved` is called
// with the indices of what a visitor has changed.
export function sliders(quantities, values, moved) {
  const toStep = (i) => Math.round((STEPS * (values[i] - quantities[i].low)) / (quantities[i].high - quantities[i].low));

  function show() {
    quantities.forEach((v, i) => {
      if (v.choices?.length) {
        find(`v${i}`).value = values[i];
        return;
      }
      const text = `${number(values[i])}${v.unit ? ` ${v.unit}` : ""}`;
      find(`v${i}`).value = toStep(i);
      find(`v${i}`).setAttribute("aria-valuetext", text);
      find(`t${i}`).value = plain(values[i]);
      refuse(find(`t${i}`));
    });
  }

  function set(i, value) {
    const { low, step } = quantities[i];
    if (step) value = Number((low + Math.round((value - low) / step) * step).toPrecision(12));
    values[i] = Math.min(quantities[i].high, Math.max(quantities[i].low, value));
  }

  // Without the last digits, which are the rounding of a sum: 0.07, not 0.06999999999999999.
  function setComputed(i, value) {
    set(i, Number(value.toPrecision(12)));
  }

  function typed(i, text) {
    const v = quantities[i];
    const value = text.trim() === "" ? NaN : Number(text.replace("−", "-"));
    if (value >= v.low && value <= v.high) {
      set(i, value);
      moved([i]);
    } else refuse(find(`t${i}`), `${v.text}: a number from ${plain(v.low)} to ${plain(v.high)}, not “${text}”.`);
  }

  quantities.forEach((v, i) => {
    if (v.choices?.length) {
      find(`v${i}`).addEventListener("change", (event) => {
        set(i, Number(event.target.value));
        moved([i]);
      });
      return;
    }
    if (v.step) find(`v${i}`).step = (STEPS * v.step) / (v.high - v.low);
    find(`v${i}`).addEventListener("input", (event) => {
      setComputed(i, v.low + (Number(event.target.value) / STEPS) * (v.high - v.low));
      moved([i]);
    });
    find(`t${i}`).addEventListener("change", (event) => typed(i, event.target.value));
  });
  return { show, set, setComputed };
}

// --- requests ------------------------------------------------------------------------------------------------------

export async function ask(question, data) {
  const start = performance.now();
  const response = await fetch(`api/${question}`, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(data),
  });
  const answer = await response.json();
  if (!response.ok) throw new Error(answer.error || response.statusText);
  document.body.dataset[`${question}Ms`] = (performance.now() - start).toFixed(1);
  return answer;
}

function showError(error) {
  find("status").textContent = `No answer: ${error.message}`;
}

// Runs one request at a time; of those made meanwhile only the last runs. Meanwhile the place with this id is busy.
export function latest(run, id) {
  let busy = false;
  let pending = false;
  return async function start() {
    if (busy) {
      pending = true;
      return;
    }
    busy = true;
    find(id)?.setAttribute("aria-busy", "true");
    try {
      do {
        pending = false;
        await run();
      } while (pending);
      if (find("status").textContent.startsWith("No answer")) find("status").textContent = "";
    } catch (error) {
      showError(error);
    } finally {
      busy = false;
      find(id)?.setAttribute("aria-busy", "false");
    }
  };
}

// --- drawings ----------------------------------------------------------------------------------------------------------

// Parses the server's SVG instead of writing it into the page; the page's policy blocks scripts in it.
export function showDrawing(place, svg) {
  const parsed = new DOMParser().parseFromString(svg, "image/svg+xml").documentElement;
  place.replaceChildren(document.importNode(parsed, true));
}
