// The page of all campaigns: asks for news and shows them.

import { ask, find, latest } from "./common.js";

const PAUSE = 2000; // [ms]

const news = latest(async () => {
  const place = find("runs");
  const { digest, html } = await ask("runs", { known: place.dataset.digest });
  if (html === null) return;
  const focused = document.activeElement?.getAttribute("href");
  place.replaceChildren(...new DOMParser().parseFromString(html, "text/html").body.childNodes);
  place.dataset.digest = digest;
  if (focused) [...place.querySelectorAll("a")].find((it) => it.getAttribute("href") === focused)?.focus();
});

// Opening a campaign for the first time takes a few seconds. A new tab opens it elsewhere.
find("runs").addEventListener("click", (event) => {
  if (event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.target.closest("a")?.closest("tr").setAttribute("aria-busy", "true");
});
setInterval(() => document.hidden || news(), PAUSE);
