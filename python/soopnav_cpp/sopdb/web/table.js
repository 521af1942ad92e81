// The list of sources: one page of it, sorted by a column, walked with the arrow keys.

import { byId, h, s, say } from "./dom.js";
import { age, carrier, place, metres, secondsWithSigma } from "./format.js";
import { shapeOf } from "./map.js";

const GRADES = {
  A: "three contributors or more, the newest word at most a day old",
  B: "two contributors, at most a week old",
  C: "at most thirty days old",
  D: "older than thirty days",
};

/** A grade as a badge: its letter, and in words for who cannot see colours. */
export function gradeBadge(grade) {
  return h("span", { class: `grade grade-${grade in GRADES ? grade : "D"}`, title: GRADES[grade] ?? "" }, grade);
}

export function kindMark(kind) {
  return s("svg", { class: `kindmark kind-${kind}`, viewBox: "-9 -9 18 18", "aria-hidden": "true" }, s("path", { d: shapeOf(kind) }));
}

function clockSigma(source) {
  return source.clock ? Math.sqrt(source.clock.covariance[0][0]) : Infinity;
}

// `from`: the width of the list [px] from which the column has room.
const COLUMNS = [
  { name: "Name", key: (x) => x.name.toLocaleLowerCase(), cell: null },
  { name: "Kind", key: (x) => x.kind, cell: (x) => h("span", { class: "kind" }, kindMark(x.kind), x.kind), from: 330 },
  { name: "Carrier", key: (x) => x.carrier_hz, cell: (x) => carrier(x.carrier_hz), right: true, from: 580 },
  {
    name: "Position",
    key: (x) => x.position?.sigma_m ?? Infinity,
    hint: "sorts by standard deviation",
    cell: (x) =>
      x.position
        ? [place(x.position.latitude_deg, x.position.longitude_deg, x.position.sigma_m), h("span", { class: "sigma" }, ` ± ${metres(x.position.sigma_m)}`)]
        : h("span", { class: "none" }, "unknown"),
    from: 900,
  },
  {
    name: "Clock offset",
    key: clockSigma,
    hint: "sorts by standard deviation",
    cell: (x) =>
      x.clock ? secondsWithSigma(x.clock.bias_s, clockSigma(x)) : h("span", { class: "none" }, "unknown"),
    right: true,
    from: 660,
  },
  { name: "Heard", key: (x) => x.quality.age_s ?? Infinity, cell: (x) => (x.quality.age_s === null ? "–" : `${age(x.quality.age_s)} ago`), right: true },
  { name: "From", key: (x) => -x.quality.contributions, hint: "number of contributions", cell: (x) => String(x.quality.contributions), right: true, from: 760 },
  { name: "Grade", key: (x) => x.quality.grade, cell: (x) => gradeBadge(x.quality.grade) },
];

export class SourceTable {
  constructor({ onOpen }) {
    this.onOpen = onOpen;
    this.sources = [];
    this.order = { column: 0, down: false };
    this.current = null;
    this.openId = null;
    this.rows = byId("rows");
    this.headings = COLUMNS.map((column, index) =>
      h(
        "th",
        { scope: "col", class: this.classOf(column), "aria-sort": "none" },
        h("button", { type: "button", title: column.hint ?? null, onclick: () => this.sortBy(index) }, column.name, h("span", { class: "arrow", "aria-hidden": "true" })),
      ),
    );
    byId("headings").replaceChildren(...this.headings);
    this.rows.addEventListener("keydown", (event) => this.key(event));
    this.rows.addEventListener("focusin", (event) => {
      const button = event.target.closest("button[data-id]");
      if (button) this.makeCurrent(button.dataset.id);
    });
    this.rows.addEventListener("click", (event) => {
      const row = event.target.closest("tr");
      if (row && !window.getSelection()?.toString()) this.onOpen(row.dataset.id, this.buttonOf(row.dataset.id));
    });
  }

  classOf(column) {
    return [column.right ? "right" : "", column.from ? `from-${column.from}` : ""].filter(Boolean).join(" ");
  }

  show(sources) {
    this.sources = sources;
    this.render();
  }

  sortBy(index) {
    this.order = { column: index, down: this.order.column === index ? !this.order.down : false };
    this.render();
    say(`Sorted by ${COLUMNS[index].name.toLowerCase()}, ${this.order.down ? "descending" : "ascending"}.`);
  }

  sorted() {
    const { key } = COLUMNS[this.order.column];
    const sign = this.order.down ? -1 : 1;
    const compare = (a, b) => {
      const [x, y] = [key(a), key(b)];
      if (typeof x === "string") return x.localeCompare(y, undefined, { numeric: true });
      return x === y ? 0 : x < y ? -1 : 1;
    };
    // Equal ones stay in the service's order.
    return this.sources.map((source, i) => [source, i]).sort(([a, i], [b, j]) => sign * compare(a, b) || i - j);
  }

  render() {
    const hadFocus = this.rows.contains(document.activeElement);
    this.headings.forEach((heading, index) => {
      const active = index === this.order.column;
      heading.setAttribute("aria-sort", active ? (this.order.down ? "descending" : "ascending") : "none");
    });
    const order = this.sorted().map(([source]) => source);
    if (!order.some((source) => String(source.id) === this.current)) {
      this.current = order.length ? String(order[0].id) : null;
    }
    this.rows.replaceChildren(...order.map((source) => this.row(source)));
    if (hadFocus) this.buttonOf(this.current)?.focus();
  }

  row(source) {
    const id = String(source.id);
    const cells = COLUMNS.slice(1).map((column) => h("td", { class: this.classOf(column) }, column.cell(source)));
    const button = h("button", { type: "button", "data-id": id, tabindex: id === this.current ? "0" : "-1" }, source.name);
    return h("tr", { "data-id": id, "aria-current": id === this.openId ? "true" : null }, h("th", { scope: "row" }, button), cells);
  }

  buttonOf(id) {
    return [...this.rows.querySelectorAll("button[data-id]")].find((button) => button.dataset.id === String(id)) ?? null;
  }

  makeCurrent(id) {
    this.current = id;
    for (const button of this.rows.querySelectorAll("button[data-id]")) {
      button.tabIndex = button.dataset.id === id ? 0 : -1;
    }
  }

  /** Marks the source that is open, or none. */
  mark(id) {
    this.openId = id === null ? null : String(id);
    for (const row of this.rows.children) {
      if (row.dataset.id === this.openId) row.setAttribute("aria-current", "true");
      else row.removeAttribute("aria-current");
    }
  }

  key(event) {
    const buttons = [...this.rows.querySelectorAll("button[data-id]")];
    const at = buttons.indexOf(document.activeElement);
    if (at < 0 || event.altKey || event.ctrlKey || event.metaKey) return;
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: buttons.length - 1, PageDown: at + 10, PageUp: at - 10 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    const button = buttons[Math.min(Math.max(to, 0), buttons.length - 1)];
    button.focus();
    button.scrollIntoView({ block: "nearest" });
  }
}
