// The page: what is asked of the service, what is shown, where the focus goes.

import { Failure, keepToken, request, token } from "./api.js";
import { showAdministration } from "./admin.js";
import { detailPanel } from "./detail.js";
import { byId, h, say } from "./dom.js";
import { count } from "./format.js";
import { SourceMap } from "./map.js";
import { SourceTable, kindMark } from "./table.js";

const REFRESH_S = 60;
const KIND_NAMES = [...byId("filter-kind").options].filter((option) => option.value).map((o) => [o.value, o.text]);

const state = {
  filters: { kind: "", name: "", near: "", radius_m: "", bbox: "" },
  cursors: [""], // of the pages up to the one shown
  next: null,
  sources: [],
  open: null, // id
  at: null, // asked time of the open source's clock, null for now
  opener: null, // what gets the focus back
  loading: null, // AbortController
  retry: null,
};

const table = new SourceTable({ onOpen: open });
const map = new SourceMap(byId("map"), { onOpen: open });

// ---- messages

function hideBanner() {
  clearTimeout(state.retry);
  byId("banner").hidden = true;
  byId("banner").replaceChildren();
}

/** A failure as a sentence, with what can be done: again now, again by itself after a while, another token. */
function report(error, again) {
  if (error.name === "AbortError") return;
  if (!(error instanceof Failure)) throw error;
  hideBanner();
  const banner = byId("banner");
  banner.dataset.kind = error.kind;
  const actions = [];
  let sentence = error.message;
  if (error.kind === "token" || error.kind === "role") {
    actions.push(h("button", { type: "button", onclick: askToken }, "Enter a token"));
  }
  if (again && error.kind !== "token" && error.kind !== "role" && error.kind !== "request") {
    actions.push(h("button", { type: "button", onclick: () => again() }, "Try again"));
  }
  if (again && error.retryAfterS !== null) {
    sentence += ` Trying again in ${error.retryAfterS} s.`;
    state.retry = setTimeout(again, error.retryAfterS * 1000);
  }
  banner.replaceChildren(h("span", {}, sentence), ...actions);
  banner.hidden = false;
}

// ---- the list

function parameters() {
  return {
    kind: state.filters.kind,
    name: state.filters.name,
    near: state.filters.near,
    radius_m: state.filters.near ? state.filters.radius_m : "",
    bbox: state.filters.bbox,
    limit: byId("page-size").value,
    cursor: state.cursors[state.cursors.length - 1],
  };
}

function filtered() {
  return Object.entries(state.filters).some(([name, value]) => name !== "radius_m" && value !== "");
}

async function load({ fit = false, quiet = false } = {}) {
  state.loading?.abort();
  const loading = new AbortController();
  state.loading = loading;
  const list = byId("sources");
  list.setAttribute("aria-busy", "true");
  try {
    const answer = await request("v1/sources", { parameters: parameters(), signal: loading.signal });
    hideBanner();
    state.sources = answer.sources;
    state.next = answer.next_cursor;
    table.show(state.sources);
    map.show(state.sources, { fit });
    describe(quiet);
  } catch (error) {
    if (!loading.signal.aborted && (error.kind === "token" || error.kind === "role")) {
      // What an earlier token was allowed to read is not left standing.
      state.sources = [];
      state.next = null;
      table.show([]);
      map.show([]);
      close({ focus: false });
      byId("summary").textContent = "";
      byId("empty").hidden = true;
      byId("table").hidden = true;
    }
    if (!loading.signal.aborted) report(error, () => load({ fit, quiet }));
  } finally {
    if (state.loading === loading) list.removeAttribute("aria-busy");
  }
}

function describe(quiet) {
  const page = state.cursors.length;
  const shown = state.sources.length;
  const first = page === 1 && state.next === null;
  const what = count(shown, "source", "sources");
  const text = `${first ? what : `${what} on page ${page}`}${filtered() ? " match the filter" : ""}`;
  byId("summary").textContent = text;
  byId("page-number").textContent = `Page ${page}`;
  byId("previous").disabled = page === 1;
  byId("next").disabled = state.next === null;
  byId("filter-clear").hidden = !filtered();
  byId("filter-area").setAttribute("aria-pressed", String(state.filters.bbox !== ""));
  byId("table").hidden = shown === 0;
  const empty = byId("empty");
  empty.hidden = shown > 0;
  if (shown === 0) {
    empty.replaceChildren(
      ...(filtered()
        ? [h("p", {}, "No source matches the filter."), h("button", { type: "button", onclick: clearFilters }, "Show all sources")]
        : [
            h("p", {}, "No source is known yet."),
            h("p", {}, "A receiver contributes the first one with ", h("code", {}, "soopnav sopdb push FILE.json"), "."),
          ]),
    );
  }
  if (!quiet) say(shown ? `${text}.` : empty.firstChild.textContent);
}

function restart() {
  state.cursors = [""];
  return load({ fit: state.filters.bbox === "" });
}

/** Latitude and longitude as text for the service, or null. */
function parseNear(text) {
  const parts = text.trim().split(/[\s,;]+/);
  if (parts.length !== 2) return null;
  const [latitude, longitude] = parts.map(Number);
  if (!(Math.abs(latitude) <= 90 && Math.abs(longitude) <= 180)) return null;
  return `${latitude},${longitude}`;
}

function applyFilters(event) {
  event?.preventDefault();
  const near = byId("filter-near");
  const radius = byId("filter-radius");
  const problem = byId("near-problem");
  let place = "";
  problem.textContent = "";
  near.removeAttribute("aria-invalid");
  if (near.value.trim()) {
    place = parseNear(near.value);
    if (place === null || !(Number(radius.value) > 0)) {
      problem.textContent = place === null
        ? "Near: a latitude and a longitude in degrees expected, such as 60.2, 24.9."
        : "Within: a number of kilometres expected.";
      near.setAttribute("aria-invalid", "true");
      (place === null ? near : radius).focus();
      return;
    }
  }
  state.filters = {
    ...state.filters,
    kind: byId("filter-kind").value,
    name: byId("filter-name").value.trim(),
    near: place,
    radius_m: place ? String(Number(radius.value) * 1000) : "",
  };
  restart();
}

function clearFilters() {
  byId("filters").reset();
  byId("near-problem").textContent = "";
  byId("filter-near").removeAttribute("aria-invalid");
  state.filters = { kind: "", name: "", near: "", radius_m: "", bbox: "" };
  byId("filter-kind").focus();
  restart();
}

function filterArea() {
  if (state.filters.bbox) state.filters.bbox = "";
  else {
    const { south, west, north, east } = map.bounds();
    state.filters.bbox = [west, south, east, north].map((degrees) => degrees.toFixed(6)).join(",");
  }
  restart();
}

// ---- one source

function open(id, opener) {
  state.opener = opener ?? null;
  const wanted = `#source/${encodeURIComponent(id)}`;
  if (location.hash === wanted) showDetail(id);
  else location.hash = wanted;
}

async function showDetail(id, { focus = true } = {}) {
  if (state.open !== id) state.at = null;
  state.open = id;
  const path = `v1/sources/${encodeURIComponent(id)}`;
  const parameters = { at: state.at ?? "" };
  const kept = (promise) => promise.catch((error) => (error instanceof Failure ? error : Promise.reject(error)));
  try {
    const source = await request(path, { parameters });
    const [stability, contributions] = await Promise.all([
      source.noise ? kept(request(`${path}/stability`)) : null,
      kept(request(`${path}/contributions`)),
    ]);
    if (state.open !== id) return; // another was opened meanwhile
    const panel = byId("detail");
    panel.replaceChildren(
      ...detailPanel({
        source,
        stability,
        contributions: contributions instanceof Error ? contributions : contributions.contributions,
        at: state.at,
        onTime: (at) => {
          state.at = at;
          showDetail(id, { focus: false }).then(() => byId("clock-time")?.focus());
        },
        onClose: () => close(),
        onCentre: () => {
          map.centre(source);
          byId("map").scrollIntoView({ block: "nearest" });
        },
      }),
    );
    panel.hidden = false;
    document.body.classList.add("has-detail");
    table.mark(id);
    map.mark(id);
    if (focus) {
      byId("detail-title").focus({ preventScroll: true });
      panel.scrollTop = 0;
      const { top } = panel.getBoundingClientRect();
      if (top < 0 || top > window.innerHeight / 2) panel.scrollIntoView({ block: "start" });
    }
  } catch (error) {
    report(error, () => showDetail(id, { focus }));
    if (error.kind === "missing") close();
  }
}

function close({ focus = true } = {}) {
  const id = state.open;
  state.open = null;
  byId("detail").hidden = true;
  byId("detail").replaceChildren();
  document.body.classList.remove("has-detail");
  table.mark(null);
  map.mark(null);
  if (location.hash.startsWith("#source/")) history.pushState(null, "", location.pathname + location.search);
  if (focus && id !== null) {
    const opener = state.opener?.isConnected ? state.opener : table.buttonOf(id);
    (opener ?? byId("sources")).focus();
  }
}

function followHash() {
  const match = /^#source\/([\w.~-]+)$/.exec(location.hash);
  if (match) {
    showPage("sources");
    showDetail(match[1]);
  } else if (state.open !== null) close();
}

// ---- pages, token, theme

function showPage(name) {
  for (const page of ["sources", "admin"]) {
    byId(`page-${page}`).hidden = page !== name;
    if (page === name) byId(`tab-${page}`).setAttribute("aria-current", "page");
    else byId(`tab-${page}`).removeAttribute("aria-current");
  }
  hideBanner();
  if (name === "admin") return showAdministration((error) => report(error, () => showPage("admin")));
  map.resized();
  return Promise.resolve();
}

function describeToken() {
  byId("token-button").textContent = token() ? "Token: in use" : "Token";
}

function askToken() {
  byId("token-input").value = "";
  byId("token-problem").textContent = "";
  byId("token-forget").hidden = !token();
  byId("token-dialog").showModal();
  byId("token-input").focus();
}

function useToken(text) {
  try {
    keepToken(text);
  } catch (error) {
    if (!(error instanceof Failure)) throw error;
    byId("token-problem").textContent = error.message;
    return;
  }
  byId("token-dialog").close();
  describeToken();
  hideBanner();
  if (byId("page-admin").hidden) restart();
  else showPage("admin");
}

function themes() {
  const button = byId("theme-button");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let chosen = null;
  try {
    chosen = localStorage.getItem("sopdb-theme");
  } catch {
    // No storage: the system's choice holds.
  }
  const apply = () => {
    const theme = chosen === "dark" || chosen === "light" ? chosen : dark.matches ? "dark" : "light";
    document.documentElement.dataset.theme = theme;
    button.textContent = theme === "dark" ? "Light" : "Dark";
    button.setAttribute("aria-label", `Switch to ${theme === "dark" ? "light" : "dark"} colours`);
  };
  dark.addEventListener("change", apply);
  button.addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    try {
      localStorage.setItem("sopdb-theme", chosen);
    } catch {
      // It holds until the page is left.
    }
    apply();
  });
  apply();
}

function wire() {
  byId("legend").replaceChildren(...KIND_NAMES.map(([kind, name]) => h("li", {}, kindMark(kind), name)));
  byId("filters").addEventListener("submit", applyFilters);
  byId("filter-kind").addEventListener("change", applyFilters);
  byId("filter-area").addEventListener("click", filterArea);
  byId("filter-clear").addEventListener("click", clearFilters);
  byId("refresh").addEventListener("click", () => load());
  byId("page-size").addEventListener("change", restart);
  byId("next").addEventListener("click", () => {
    state.cursors.push(state.next);
    load({ fit: true });
  });
  byId("previous").addEventListener("click", () => {
    state.cursors.pop();
    load({ fit: true });
  });
  byId("tab-sources").addEventListener("click", () => showPage("sources"));
  byId("tab-admin").addEventListener("click", () => showPage("admin"));
  byId("token-button").addEventListener("click", askToken);
  byId("token-cancel").addEventListener("click", () => byId("token-dialog").close());
  byId("token-forget").addEventListener("click", () => useToken(null));
  byId("token-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const text = byId("token-input").value.trim();
    if (!/^[\x21-\x7e]+$/.test(text)) {
      byId("token-problem").textContent = "A token is one word of letters, digits and signs, without blanks.";
      return;
    }
    useToken(text);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && state.open !== null && !byId("token-dialog").open) close();
  });
  window.addEventListener("hashchange", followHash);
  window.addEventListener("popstate", followHash);
  setInterval(() => {
    if (!document.hidden && !byId("page-sources").hidden && byId("banner").hidden) load({ quiet: true });
  }, REFRESH_S * 1000);
}

themes();
wire();
describeToken();
load({ fit: true }).then(followHash);
