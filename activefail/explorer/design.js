// The page Design of `activefail explore`: sends site, bearing and target to the server and shows its answers.

import { about, ask, find, latest, plain, refuse, showDrawing, sliders, withSubscripts } from "./common.js";

document.querySelectorAll("[data-subscript]").forEach((place) => place.replaceChildren(withSubscripts(place.textContent)));
begin();

function begin() {
  const quantities = [...about.periods, ...about.site, ...about.bearing];
  const values = quantities.map((v) => v.start);
  const firstOfBearing = about.periods.length + about.site.length;
  let target = about.targets[0].value;
  let byPeriod = 0;
  let version = 0;

  // --- the answer --------------------------------------------------------------------------------------------------

  function request() {
    const named = (from, to) => quantities.slice(from, to).map((v, k) => [v.name, values[from + k]]);
    const site = [...named(byPeriod, byPeriod + 1), ...named(about.periods.length, firstOfBearing)];
    return { site: Object.fromEntries(site), bearing: Object.fromEntries(named(firstOfBearing)), target };
  }

  function listed(id, sentences) {
    find(id).replaceChildren(
      ...sentences.map((text) => {
        const item = document.createElement("li");
        item.append(withSubscripts(text));
        return item;
      }),
    );
  }

  // Until there is an answer to the present values, the page dims the former one.
  function dim(isFormer) {
    document.querySelector(".answer").setAttribute("aria-busy", String(isFormer));
  }

  function showAnswer(answer) {
    dim(false);
    find("value").textContent = answer.value;
    find("required").replaceChildren(withSubscripts(answer.text));
    Object.assign(find("required").dataset, { required: answer.required, probability: answer.probability });
    const period = plain(Number(answer.median_period.toPrecision(3)));
    const outside = `${answer.outside_text} of the pulses and bearings lie outside the campaign's design space, where the classifier extrapolates`;
    find("accuracy").replaceChildren(withSubscripts(`Median T_p ${period} s. ${outside}.`));
    showDrawing(find("curve"), answer.svg);
    listed("notes", answer.notes);
  }

  const answer = latest(async () => {
    const asked = version;
    const reply = await ask("design", request());
    if (asked === version) showAnswer(reply);
  });

  function moved() {
    version += 1;
    dim(true);
    show();
    if (find("earlier")) find("earlier").hidden = find("found").hidden;
    answer();
  }

  const { show } = sliders(quantities, values, moved);

  // --- the choices -------------------------------------------------------------------------------------------------

  function showPeriods() {
    about.periods.forEach((v, i) => (find(`s${i}`).hidden = i !== byPeriod));
  }

  function showTarget() {
    find("target").value = plain(100 * target);
    refuse(find("target"));
    const known = about.targets.find((it) => it.value === target);
    find("category").value = known ? String(known.value) : "";
  }

  document.querySelectorAll("[name=period]").forEach((button) =>
    button.addEventListener("change", (event) => {
      byPeriod = Number(event.target.value);
      showPeriods();
      moved();
    }),
  );
  find("category").addEventListener("change", (event) => {
    if (event.target.value === "") {
      find("target").focus();
      return;
    }
    target = Number(event.target.value);
    showTarget();
    moved();
  });
  find("target").addEventListener("change", (event) => {
    const text = event.target.value.trim();
    const value = text === "" ? NaN : Number((Number(text) / 100).toPrecision(12));
    if (value >= about.low && value <= about.high) {
      target = value;
      showTarget();
      moved();
    } else {
      refuse(event.target, `Target: a number from ${plain(100 * about.low)} to ${plain(100 * about.high)} %, not “${text}”.`);
    }
  });

  // --- the verification --------------------------------------------------------------------------------------------

  const POLL = 300; // [ms]
  const LAST = "activefail-verification";
  let job = null;
  let askedAt = -1;

  function showJob() {
    const isRunning = job.state === "running";
    find("verify").disabled = isRunning;
    find("stop").hidden = find("running").hidden = !isRunning;
    find("bar").value = Math.max(0, job.step - 1);
    const counts = `${job.predictions} predictions and ${job.simulations} simulations so far`;
    const texts = { done: "", stopped: "Stopped.", failed: `No result: ${job.error}` };
    find("job").textContent = isRunning ? `Step ${job.step} of at most ${job.steps}: ${job.text}; ${counts}.` : texts[job.state];
    find("job").dataset.state = job.state;
    find("found").hidden = job.state !== "done";
    if (job.state !== "done") return;
    const { result } = job;
    find("verdict").replaceChildren(withSubscripts(result.verdict));
    find("verdict").dataset.status = result.status;
    find("estimate").replaceChildren(withSubscripts(result.text));
    listed("assumptions", result.assumptions);
    find("earlier").hidden = askedAt === version;
  }

  async function follow() {
    showJob();
    while (job.state === "running") {
      await new Promise((resolve) => setTimeout(resolve, POLL));
      job = await ask("progress", { id: job.id });
      showJob();
    }
  }

  // Shows why an action failed, and lets the visitor verify again.
  async function attempted(action) {
    try {
      await action();
    } catch (error) {
      find("job").textContent = error.message;
    } finally {
      find("verify").disabled = false;
      find("stop").hidden = find("running").hidden = true;
    }
  }

  async function verify() {
    find("verify").disabled = true;
    askedAt = version;
    job = await ask("verify", request());
    sessionStorage.setItem(LAST, job.id);
    await follow();
  }

  async function stop() {
    try {
      await ask("stop", { id: job.id });
    } catch (error) {
      find("job").textContent = error.message;
    }
  }

  async function followEarlier() {
    // The page may have been loaded again while a verification runs.
    try {
      job = await ask("progress", { id: sessionStorage.getItem(LAST) });
    } catch {
      sessionStorage.removeItem(LAST);
      return;
    }
    await follow();
  }

  if (find("verify")) {
    find("verify").addEventListener("click", () => attempted(verify));
    find("stop").addEventListener("click", stop);
    if (sessionStorage.getItem(LAST)) attempted(followEarlier);
  }
  showPeriods();
  showTarget();
  moved();
}
