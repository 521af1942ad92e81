// Allan deviation over averaging time, both logarithmic, with its 95 % band. Arrow keys or the pointer read values off.

import { h, s } from "./dom.js";
import { powerOfTen, scientific } from "./format.js";

const WIDTH = 430;
const HEIGHT = 300;
const BOX = { left: 66, right: WIDTH - 16, top: 14, bottom: HEIGHT - 52 };

function decades(low, high) {
  const first = Math.floor(Math.log10(low) + 1e-9);
  const last = Math.ceil(Math.log10(high) - 1e-9);
  return [first, Math.max(last, first + 1)];
}

function tau(value) {
  return `${Number(value.toPrecision(3))} s`;
}

/**
 * A figure for `name`: curve.tau_s, curve.deviation, curve.lower and curve.upper, arrays of one length, ascending in tau_s.
 * Throws RangeError for arrays that are no such curve.
 */
export function allanPlot(name, curve) {
  const { tau_s: taus, deviation, lower: low, upper: high } = curve;
  const all = [taus, deviation, low, high];
  const usable = all.every((a) => Array.isArray(a) && a.length === taus.length && a.every((x) => x > 0 && x < Infinity));
  if (!usable || taus.length < 2) throw new RangeError("no curve");

  const [x0, x1] = decades(taus[0], taus[taus.length - 1]);
  const [y0, y1] = decades(Math.min(...low), Math.max(...high));
  const x = (value) => BOX.left + ((Math.log10(value) - x0) / (x1 - x0)) * (BOX.right - BOX.left);
  const y = (value) => BOX.bottom - ((Math.log10(value) - y0) / (y1 - y0)) * (BOX.bottom - BOX.top);
  const path = (values) => values.map((value, i) => `${x(taus[i]).toFixed(1)},${y(value).toFixed(1)}`);

  const grid = [];
  const labels = [];
  // Decades further apart than the axis has room for are left unlabelled.
  const every = Math.ceil((y1 - y0) / 9);
  for (let decade = x0; decade <= x1; decade += 1) {
    const at = x(10 ** decade);
    grid.push(s("line", { x1: at, x2: at, y1: BOX.top, y2: BOX.bottom }));
    const text = decade >= -2 && decade <= 3 ? String(Number((10 ** decade).toPrecision(1))) : powerOfTen(decade);
    labels.push(s("text", { x: at, y: BOX.bottom + 19, "text-anchor": "middle" }, text));
    for (let minor = 2; minor < 10 && decade < x1; minor += 1) {
      const between = x(minor * 10 ** decade);
      grid.push(s("line", { x1: between, x2: between, y1: BOX.bottom, y2: BOX.bottom - 5, class: "tick" }));
    }
  }
  for (let decade = y0; decade <= y1; decade += 1) {
    const at = y(10 ** decade);
    grid.push(s("line", { x1: BOX.left, x2: BOX.right, y1: at, y2: at }));
    if ((decade - y0) % every === 0) {
      labels.push(s("text", { x: BOX.left - 8, y: at + 4.5, "text-anchor": "end" }, powerOfTen(decade)));
    }
    for (let minor = 2; minor < 10 && decade < y1; minor += 1) {
      const between = y(minor * 10 ** decade);
      grid.push(s("line", { x1: BOX.left, x2: BOX.left + 5, y1: between, y2: between, class: "tick" }));
    }
  }
  const cursor = s(
    "g",
    { class: "cursor", visibility: "hidden" },
    s("line", { y1: BOX.top, y2: BOX.bottom }),
    s("circle", { r: 4.5 }),
  );
  const best = deviation.indexOf(Math.min(...deviation));
  const summary =
    `Allan deviation of ${name}: ${scientific(deviation[0])} at ${tau(taus[0])}, least ` +
    `${scientific(deviation[best])} at ${tau(taus[best])}, ${scientific(deviation[deviation.length - 1])} at ` +
    `${tau(taus[taus.length - 1])}. Left and right arrow keys read values.`;
  const svg = s(
    "svg",
    { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", tabindex: "0", "aria-label": summary, class: "allan", focusable: "true" },
    s("g", { class: "plotgrid" }, grid),
    s("polygon", { class: "band", points: [...path(high), ...path(low).reverse()].join(" ") }),
    s("polyline", { class: "curve", points: path(deviation).join(" ") }),
    s("rect", { class: "frame", x: BOX.left, y: BOX.top, width: BOX.right - BOX.left, height: BOX.bottom - BOX.top }),
    s("g", { class: "ticklabels" }, labels),
    s("text", { class: "axis", x: (BOX.left + BOX.right) / 2, y: HEIGHT - 10, "text-anchor": "middle" }, "Averaging time τ [s]"),
    s(
      "text",
      { class: "axis", transform: `translate(17 ${(BOX.top + BOX.bottom) / 2}) rotate(-90)`, "text-anchor": "middle" },
      "Allan deviation σ",
      s("tspan", { dy: 4, "font-size": 10 }, "y"),
      s("tspan", { dy: -4 }, "(τ)"),
    ),
    cursor,
  );

  const readout = h("output", { class: "readout" }, "Point at the curve, or use the arrow keys, to read values.");
  let at = null;
  const show = (index) => {
    at = Math.min(Math.max(index, 0), taus.length - 1);
    cursor.setAttribute("visibility", "visible");
    const [line, dot] = cursor.children;
    line.setAttribute("x1", x(taus[at]));
    line.setAttribute("x2", x(taus[at]));
    dot.setAttribute("cx", x(taus[at]));
    dot.setAttribute("cy", y(deviation[at]));
    readout.textContent =
      `τ = ${tau(taus[at])}: σ_y = ${scientific(deviation[at], 2)}, ` +
      `95 % ${scientific(low[at])} … ${scientific(high[at])}`;
  };
  svg.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity };
    if (!(event.key in moves) || event.altKey || event.ctrlKey || event.metaKey) return;
    const from = at ?? (moves[event.key] > 0 ? -1 : taus.length);
    show(from + moves[event.key]);
    event.preventDefault();
  });
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const wanted = ((event.clientX - box.left) / box.width) * WIDTH;
    let nearest = 0;
    taus.forEach((value, i) => {
      if (Math.abs(x(value) - wanted) < Math.abs(x(taus[nearest]) - wanted)) nearest = i;
    });
    show(nearest);
  });

  const step = Math.max(1, Math.round(taus.length / 12));
  const rows = taus
    .map((value, i) => i)
    .filter((i) => i % step === 0 || i === taus.length - 1)
    .map((i) => h("tr", {}, [taus[i], deviation[i], low[i], high[i]].map((v, c) => h("td", {}, c ? scientific(v) : tau(v)))));
  return h(
    "figure",
    { class: "plot" },
    svg,
    h("figcaption", {}, readout, h("span", { class: "key" }, "Line: best value. Band: 95 % of what the characterisations leave open.")),
    h(
      "details",
      {},
      h("summary", {}, "As numbers"),
      h(
        "table",
        { class: "numbers" },
        h("thead", {}, h("tr", {}, ["τ", "σ_y", "2.5 %", "97.5 %"].map((text) => h("th", { scope: "col" }, text)))),
        h("tbody", {}, rows),
      ),
    ),
  );
}
