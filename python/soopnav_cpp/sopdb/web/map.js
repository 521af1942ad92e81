// The map: sources where they stand, in an equirectangular projection that is true at the centre's latitude.
// Nothing is fetched for it: orientation comes from the graticule, a scale bar and the names of large cities.

import { h, s, say } from "./dom.js";
import { metres } from "./format.js";
import { CITIES } from "./cities.js";

const M_PER_DEG = 111_320;
const MIN_SCALE = 0.8; // pixels per degree of latitude
const MAX_SCALE = 4e6;
const KEY_PAN_PX = 60;

const SHAPES = {
  cdma: "M-6 0a6 6 0 1 0 12 0a6 6 0 1 0-12 0Z",
  gps: "M0-7.5L7 5.5H-7Z",
  iridium: "M0 7.5L7-5.5H-7Z",
  lte: "M-5.5-5.5H5.5V5.5H-5.5Z",
  ofdm: "M0-7.5L7.5 0L0 7.5L-7.5 0Z",
  fm: "M-3.5-6.5H3.5L7 0L3.5 6.5H-3.5L-7 0Z",
  other: "M-2.2-7H2.2V-2.2H7V2.2H2.2V7H-2.2V2.2H-7V-2.2H-2.2Z",
};

/** The outline of a kind's marker, about 14 pixels wide and centred. */
export function shapeOf(kind) {
  return SHAPES[kind] ?? SHAPES.other;
}

function wrapLongitude(degrees) {
  return ((((degrees + 180) % 360) + 360) % 360) - 180;
}

function niceStep(least) {
  for (const step of [1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45]) {
    if (step >= least) return step;
  }
  return 90;
}

/** Half axes [m] and the tilt [deg] of one standard deviation on the ground, from a covariance in ECEF axes. */
function groundEllipse(position) {
  const c = position.covariance_m2;
  const latitude = (position.latitude_deg * Math.PI) / 180;
  const longitude = (position.longitude_deg * Math.PI) / 180;
  const east = [-Math.sin(longitude), Math.cos(longitude), 0];
  const north = [
    -Math.sin(latitude) * Math.cos(longitude),
    -Math.sin(latitude) * Math.sin(longitude),
    Math.cos(latitude),
  ];
  const form = (a, b) => a.reduce((sum, x, i) => sum + x * b.reduce((inner, y, j) => inner + c[i][j] * y, 0), 0);
  const ee = form(east, east);
  const nn = form(north, north);
  const en = form(east, north);
  const middle = (ee + nn) / 2;
  const spread = Math.hypot((ee - nn) / 2, en);
  return {
    major: Math.sqrt(Math.max(middle + spread, 0)),
    minor: Math.sqrt(Math.max(middle - spread, 0)),
    tilt: (Math.atan2(2 * en, ee - nn) * 90) / Math.PI, // anticlockwise from east
  };
}

export class SourceMap {
  /** `root` is filled; `onOpen(id, marker)` is called when a reader opens a source. */
  constructor(root, { onOpen }) {
    this.root = root;
    this.onOpen = onOpen;
    this.sources = [];
    this.markers = new Map();
    this.openId = null;
    this.view = { latitude: 20, longitude: 0, scale: 2 };
    this.size = { width: 1, height: 1 };
    this.pointers = new Map();
    this.moved = false; // by the reader, since all were shown
    this.build();
    new ResizeObserver(() => this.resized()).observe(root);
  }

  build() {
    this.grid = s("g", { class: "grid", "aria-hidden": "true" });
    this.cities = s("g", { class: "cities", "aria-hidden": "true" });
    this.ellipses = s("g", { class: "ellipses", "aria-hidden": "true" });
    this.points = s("g", { class: "points" });
    this.edge = s("g", { class: "edge", "aria-hidden": "true" });
    this.svg = s(
      "svg",
      {
        tabindex: "0",
        role: "application",
        "aria-label": "Map of the sources",
        "aria-describedby": "map-help",
        focusable: "true",
      },
      this.grid,
      this.cities,
      this.ellipses,
      this.points,
      this.edge,
    );
    this.bar = h("div", { class: "scalebar", "aria-hidden": "true" });
    const button = (label, sign, act) => h("button", { type: "button", "aria-label": label, title: label, onclick: act }, sign);
    const buttons = h(
      "div",
      { class: "mapbuttons" },
      button("Zoom in", "+", () => this.zoom(2)),
      button("Zoom out", "\u2212", () => this.zoom(0.5)),
      button("Show all sources", "⤢", () => this.fit()),
    );
    this.note = h("p", { class: "mapnote", hidden: true });
    this.root.replaceChildren(this.svg, buttons, this.bar, this.note);
    this.svg.addEventListener("keydown", (event) => this.key(event));
    this.svg.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.svg.addEventListener("pointerdown", (event) => this.pointerDown(event));
    this.svg.addEventListener("pointermove", (event) => this.pointerMove(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      this.svg.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    }
  }

  /** Takes the sources of the table. The view stays unless `fit`. */
  show(sources, { fit = false } = {}) {
    const focused = document.activeElement?.closest?.(".marker")?.dataset.id ?? null;
    this.sources = sources.filter((source) => source.position !== null);
    const without = sources.length - this.sources.length;
    this.note.hidden = without === 0;
    this.note.textContent = `${without} of ${sources.length} without a known position`;
    this.markers.clear();
    const nodes = this.sources.map((source) => {
      const marker = s(
        "g",
        {
          class: `marker kind-${source.kind in SHAPES ? source.kind : "other"}`,
          role: "button",
          tabindex: "-1",
          "aria-label": `${source.name}, ${source.kind}`,
          "data-id": source.id,
          onclick: () => this.open(source.id),
        },
        s("circle", { class: "halo", r: "12" }),
        s("path", { d: shapeOf(source.kind) }),
        s("title", {}, source.name),
      );
      this.markers.set(String(source.id), marker);
      return marker;
    });
    this.points.replaceChildren(...nodes);
    this.ellipses.replaceChildren();
    if (fit) this.fit();
    else this.draw();
    this.mark(this.openId);
    if (focused !== null) this.markers.get(focused)?.focus();
  }

  /** Marks the source that is open, or none. */
  mark(id) {
    this.openId = id === null ? null : String(id);
    for (const [key, marker] of this.markers) {
      marker.classList.toggle("open", key === this.openId);
      marker.setAttribute("aria-pressed", String(key === this.openId));
    }
    const marker = this.markers.get(this.openId);
    if (marker && marker !== this.points.lastChild && document.activeElement !== marker) this.points.append(marker);
    this.draw();
  }

  /** Brings a source to the middle, near enough to tell it from its neighbours. */
  centre(source) {
    this.moved = true;
    this.view.latitude = source.position.latitude_deg;
    this.view.longitude = source.position.longitude_deg;
    this.view.scale = Math.max(this.view.scale, 8000);
    this.draw();
  }

  open(id) {
    this.onOpen(String(id), this.markers.get(String(id)));
  }

  /** All sources in view, in the shortest span of longitudes that holds them, across the date line where that is it. */
  fit() {
    this.moved = false;
    if (this.sources.length === 0) {
      this.view = { latitude: 15, longitude: 0, scale: Math.min(this.size.width / 360, this.size.height / 150) };
      this.draw();
      return;
    }
    const latitudes = this.sources.map((source) => source.position.latitude_deg);
    const longitudes = this.sources.map((source) => source.position.longitude_deg).sort((a, b) => a - b);
    let gap = longitudes[0] + 360 - longitudes[longitudes.length - 1];
    let west = longitudes[0];
    for (let i = 1; i < longitudes.length; i += 1) {
      if (longitudes[i] - longitudes[i - 1] > gap) {
        gap = longitudes[i] - longitudes[i - 1];
        west = longitudes[i];
      }
    }
    const low = Math.min(...latitudes);
    const high = Math.max(...latitudes);
    this.view.latitude = (low + high) / 2;
    this.view.longitude = wrapLongitude(west + (360 - gap) / 2);
    const shrink = Math.max(Math.cos((this.view.latitude * Math.PI) / 180), 0.05);
    this.view.scale = Math.min(
      (0.8 * this.size.width) / Math.max((360 - gap) * shrink, 1e-9),
      (0.75 * this.size.height) / Math.max(high - low, 1e-9),
      this.sources.length === 1 ? 8000 : 2e5,
    );
    this.draw();
  }

  /** South, west, north, east of the view [deg]; west > east across the date line. */
  bounds() {
    const { latitude, longitude, scale } = this.view;
    const half = this.size.width / 2 / (scale * this.shrink());
    const wide = half >= 180;
    return {
      south: Math.max(latitude - this.size.height / 2 / scale, -90),
      north: Math.min(latitude + this.size.height / 2 / scale, 90),
      west: wide ? -180 : wrapLongitude(longitude - half),
      east: wide ? 180 : wrapLongitude(longitude + half),
    };
  }

  zoom(factor, x = this.size.width / 2, y = this.size.height / 2) {
    const dx = x - this.size.width / 2;
    const dy = y - this.size.height / 2;
    const old = this.view.scale;
    const next = Math.min(Math.max(old * factor, MIN_SCALE), MAX_SCALE);
    this.pan(dx, dy);
    this.view.scale = next;
    this.pan(-dx, -dy);
    this.draw();
  }

  pan(dx, dy) {
    this.moved = true;
    const { scale } = this.view;
    this.view.longitude = wrapLongitude(this.view.longitude + dx / (scale * this.shrink()));
    this.view.latitude = Math.min(Math.max(this.view.latitude - dy / scale, -90), 90);
  }

  shrink() {
    return Math.max(Math.cos((this.view.latitude * Math.PI) / 180), 0.05);
  }

  resized() {
    const { width, height } = this.root.getBoundingClientRect();
    if (width < 1 || height < 1) return; // not displayed
    this.size = { width, height };
    if (!this.moved) this.fit();
    else this.draw();
  }

  project(latitude, longitude) {
    return [
      this.size.width / 2 + wrapLongitude(longitude - this.view.longitude) * this.view.scale * this.shrink(),
      this.size.height / 2 - (latitude - this.view.latitude) * this.view.scale,
    ];
  }

  draw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = null;
      this.drawNow();
    });
  }

  drawNow() {
    const { width, height } = this.size;
    this.view.scale = Math.min(Math.max(this.view.scale, MIN_SCALE), MAX_SCALE);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.drawGrid();
    this.drawCities();
    const ellipses = [];
    for (const source of this.sources) {
      const [x, y] = this.project(source.position.latitude_deg, source.position.longitude_deg);
      this.markers.get(String(source.id)).setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
      const perMetre = this.view.scale / M_PER_DEG;
      if (2 * source.position.sigma_m * perMetre < 7 || x < -width || x > 2 * width || y < -height || y > 2 * height) {
        continue;
      }
      const { major, minor, tilt } = groundEllipse(source.position);
      ellipses.push(
        s("ellipse", {
          rx: Math.min(2 * major * perMetre, 1e5),
          ry: Math.min(2 * minor * perMetre, 1e5),
          transform: `translate(${x.toFixed(1)} ${y.toFixed(1)}) rotate(${(-tilt).toFixed(2)})`,
          class: String(source.id) === this.openId ? "open" : "",
        }),
      );
    }
    this.ellipses.replaceChildren(...ellipses);
    this.drawScale();
  }

  drawGrid() {
    const { width, height } = this.size;
    const { scale, latitude, longitude } = this.view;
    const across = scale * this.shrink();
    const step = niceStep(90 / scale);
    const stepLongitude = niceStep(110 / across);
    const digits = (value) => Math.max(0, Math.ceil(-Math.log10(value) - 1e-9));
    const lines = [];
    const labels = [];
    const low = Math.max(Math.ceil(Math.max(latitude - height / 2 / scale, -90) / step) * step, -90);
    for (let at = low; at <= Math.min(latitude + height / 2 / scale, 90) + 1e-9; at += step) {
      const y = this.project(at, longitude)[1];
      lines.push(s("line", { x1: 0, x2: width, y1: y, y2: y, class: Math.abs(at) < step / 2 ? "main" : "" }));
      if (y > 22 && y < height - 30) {
        const name = Math.abs(at) < step / 2 ? "0°" : `${Math.abs(at).toFixed(digits(step))}° ${at < 0 ? "S" : "N"}`;
        labels.push(s("text", { x: 6, y: y - 4 }, name));
      }
    }
    const half = Math.min(width / 2 / across, 180);
    const first = Math.ceil((longitude - half) / stepLongitude) * stepLongitude;
    for (let at = first; at < longitude + half - 1e-9; at += stepLongitude) {
      const x = width / 2 + (at - longitude) * across;
      const value = wrapLongitude(Number(at.toFixed(6)));
      const zero = Math.abs(value) < stepLongitude / 2;
      lines.push(s("line", { x1: x, x2: x, y1: 0, y2: height, class: zero ? "main" : "" }));
      if (x > 60 && x < width - 110) {
        const size = `${Math.abs(value).toFixed(digits(stepLongitude))}°`;
        const side = zero || Math.abs(value) === 180 ? "" : value < 0 ? " W" : " E";
        labels.push(s("text", { x: x + 4, y: 16 }, size + side));
      }
    }
    this.grid.replaceChildren(...lines);
    this.edge.replaceChildren(...labels);
  }

  drawCities() {
    const { width, height } = this.size;
    const taken = [];
    const nodes = [];
    for (const [name, latitude, longitude] of CITIES) {
      const [x, y] = this.project(latitude, longitude);
      if (x < 10 || x > width - 10 || y < 26 || y > height - 26) continue;
      const box = { left: x - 6, right: x + 10 + 6.2 * name.length, top: y - 9, bottom: y + 9 };
      if (box.right > width - 50) continue;
      const clash = taken.some(
        (other) =>
          box.left < other.right && box.right > other.left && box.top < other.bottom && box.bottom > other.top,
      );
      if (clash) continue;
      taken.push(box);
      nodes.push(s("circle", { cx: x, cy: y, r: 1.8 }), s("text", { x: x + 6, y: y + 4 }, name));
    }
    this.cities.replaceChildren(...nodes);
  }

  drawScale() {
    const metresPerPixel = M_PER_DEG / this.view.scale;
    const most = 130 * metresPerPixel;
    const power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((factor) => factor * power).find((value) => value <= most) ?? power;
    const name = length >= 1000 ? `${length / 1000} km` : metres(length).replace(".0 m", " m");
    this.bar.replaceChildren(h("span", {}, name));
    this.bar.style.width = `${length / metresPerPixel}px`;
  }

  key(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const marker = event.target.closest(".marker");
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[event.key];
    if (arrow && marker && !event.shiftKey) this.neighbour(marker, ...arrow);
    else if (arrow) {
      this.pan(arrow[0] * KEY_PAN_PX, arrow[1] * KEY_PAN_PX);
      this.draw();
    } else if (event.key === "+" || event.key === "=") this.zoom(2);
    else if (event.key === "-") this.zoom(0.5);
    else if (event.key === "0") this.fit();
    else if (event.key === "Enter" || (event.key === " " && marker)) {
      if (marker) this.open(marker.dataset.id);
      else this.enter();
    } else if (event.key === "Escape" && marker) this.svg.focus();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  /** The source nearest to the middle of the view gets the focus. */
  enter() {
    const { width, height } = this.size;
    const nearest = this.nearest(([x, y]) => Math.hypot(x - width / 2, y - height / 2));
    if (nearest) nearest.focus();
    else say("No source has a known position.");
  }

  nearest(distance, except = null) {
    let best = null;
    let least = Infinity;
    for (const source of this.sources) {
      const marker = this.markers.get(String(source.id));
      if (marker === except) continue;
      const d = distance(this.project(source.position.latitude_deg, source.position.longitude_deg));
      if (d < least) [best, least] = [marker, d];
    }
    return best;
  }

  /** From a marker to the next in a direction: the nearest in a cone of 45° to either side, weighed by its angle. */
  neighbour(marker, right, down) {
    const source = this.sources.find((other) => String(other.id) === marker.dataset.id);
    const [x0, y0] = this.project(source.position.latitude_deg, source.position.longitude_deg);
    const next = this.nearest(([x, y]) => {
      const along = (x - x0) * right + (y - y0) * down;
      const aside = Math.abs((x - x0) * down) + Math.abs((y - y0) * right);
      return along > 0 && along >= aside ? along + 2 * aside : Infinity;
    }, marker);
    if (!next) {
      say("No source that way.");
      return;
    }
    next.focus();
    const other = this.sources.find((candidate) => String(candidate.id) === next.dataset.id);
    const [x, y] = this.project(other.position.latitude_deg, other.position.longitude_deg);
    if (x < 20 || y < 20 || x > this.size.width - 20 || y > this.size.height - 20) {
      this.moved = true;
      this.view.latitude = other.position.latitude_deg;
      this.view.longitude = other.position.longitude_deg;
      this.draw();
    }
  }

  wheel(event) {
    // The page scrolls past a map that is not in use.
    if (!event.ctrlKey && !this.root.contains(document.activeElement)) return;
    event.preventDefault();
    const box = this.svg.getBoundingClientRect();
    this.zoom(2 ** (-event.deltaY / 240), event.clientX - box.left, event.clientY - box.top);
  }

  pointerDown(event) {
    if (event.button !== 0) return;
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (!event.target.closest(".marker")) this.svg.setPointerCapture(event.pointerId);
  }

  pointerMove(event) {
    const old = this.pointers.get(event.pointerId);
    if (!old) return;
    const now = [event.clientX, event.clientY];
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const before = Math.hypot(old[0] - other[0], old[1] - other[1]);
      const after = Math.hypot(now[0] - other[0], now[1] - other[1]);
      const box = this.svg.getBoundingClientRect();
      if (before > 0) {
        this.zoom(after / before, (now[0] + other[0]) / 2 - box.left, (now[1] + other[1]) / 2 - box.top);
      }
      this.pan((old[0] - now[0]) / 2, (old[1] - now[1]) / 2);
    } else {
      this.pan(old[0] - now[0], old[1] - now[1]);
    }
    this.pointers.set(event.pointerId, now);
    this.draw();
  }
}
