// One source in full: position, clock at the asked time, noise as an Allan plot, quality, who contributed.

import { h } from "./dom.js";
import { age, carrier, count, factor95, fractionWithSigma, instant, metres, place, scientific, secondsWithSigma } from "./format.js";
import { allanPlot } from "./plot.js";
import { gradeBadge, kindMark } from "./table.js";

function facts(pairs) {
  return h("dl", { class: "facts" }, pairs.map(([term, value]) => h("div", {}, h("dt", {}, term), h("dd", {}, value))));
}

function positionPart(source, onCentre) {
  if (!source.position) return [h("h3", {}, "Position"), h("p", { class: "none" }, "Nobody has contributed one.")];
  const { latitude_deg: latitude, longitude_deg: longitude, height_m: height, sigma_m: sigma, p_e_m: ecef } = source.position;
  return [
    h("h3", {}, "Position"),
    facts([
      ["WGS-84", place(latitude, longitude, sigma)],
      ["Height", `${metres(height)} above the ellipsoid`],
      ["Known to", `${metres(sigma)}, one standard deviation`],
      ["ECEF", `${ecef.map((x) => x.toFixed(1).replace("-", "\u2212")).join(", ")} m`],
    ]),
    h("button", { type: "button", onclick: onCentre }, "Show on the map"),
  ];
}

function clockPart(source, at, onTime) {
  const input = h("input", { type: "datetime-local", step: "1", id: "clock-time", value: (at ?? new Date().toISOString()).slice(0, 19) });
  const form = h(
    "form",
    { class: "when" },
    h("label", { for: "clock-time" }, "Clock at ", h("span", { class: "unit" }, "UTC")),
    input,
    h("button", { type: "submit" }, "Ask"),
    h("button", { type: "button", disabled: at === null, onclick: () => onTime(null) }, "Now"),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const asked = new Date(`${input.value}Z`);
    if (!Number.isNaN(asked.getTime())) onTime(asked.toISOString());
  });
  const parts = [h("h3", {}, "Clock"), form];
  if (!source.clock) return [...parts, h("p", { class: "none" }, "Nobody has contributed its offset.")];
  const { bias_s: bias, drift, covariance, epoch } = source.clock;
  parts.push(
    facts([
      ["Offset", secondsWithSigma(bias, Math.sqrt(covariance[0][0]))],
      ["Drift", fractionWithSigma(drift, Math.sqrt(covariance[1][1]))],
      ["At", instant(epoch)],
      ...(source.clock.noise_assumed ? [["Growth", "by the noise usual for its kind; its own is not known"]] : []),
    ]),
  );
  return parts;
}

function noisePart(source, stability) {
  if (!source.noise) return [h("h3", {}, "Stability"), h("p", { class: "none" }, "Nobody has contributed its noise.")];
  const { h0_s: h0, h_minus2_per_s: hMinus2, ln_covariance: ln } = source.noise;
  const parts = [
    h("h3", {}, "Stability"),
    facts([
      ["White frequency h₀", `${scientific(h0)} s, 95 % ${factor95(Math.sqrt(ln[0][0]))}`],
      ["Frequency walk h₋₂", `${scientific(hMinus2)} Hz, 95 % ${factor95(Math.sqrt(ln[1][1]))}`],
    ]),
  ];
  if (stability instanceof Error) parts.push(h("p", { class: "problem" }, `The curve could not be read. ${stability.message}`));
  else {
    try {
      parts.push(allanPlot(source.name, stability));
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      parts.push(h("p", { class: "problem" }, "The service's curve cannot be drawn."));
    }
  }
  return parts;
}

function contributionPart(contributions) {
  if (contributions instanceof Error) return h("p", { class: "problem" }, `They could not be read. ${contributions.message}`);
  if (contributions.length === 0) return h("p", { class: "none" }, "None.");
  return h(
    "ul",
    { class: "contributions" },
    contributions.map((entry) => {
      const { provenance, quality } = entry.characterization;
      const parts = ["position", "clock", "noise"].filter((part) => entry.characterization[part] !== null);
      return h(
        "li",
        {},
        h("strong", {}, provenance.receiver),
        h("span", { class: `status status-${entry.status}` }, entry.status),
        h("span", { class: "when-given" }, instant(entry.received)),
        h(
          "span",
          { class: "how" },
          `${parts.join(", ")} by ${provenance.method.replaceAll("_", " ")}, ${age(quality.duration_s)} of signal` +
            (quality.cn0_dbhz === null ? "" : ` at ${quality.cn0_dbhz.toFixed(0)} dB-Hz`) +
            (provenance.independent ? "" : ", not independent of others"),
        ),
      );
    }),
  );
}

/** The panel of `source`; stability and contributions may be Errors. */
export function detailPanel({ source, stability, contributions, at, onTime, onClose, onCentre }) {
  const { quality } = source;
  return [
    h(
      "div",
      { class: "detailhead" },
      h("h2", { id: "detail-title", tabindex: "-1" }, source.name),
      h("button", { type: "button", class: "close", "aria-label": "Close", title: "Close (Escape)", onclick: onClose }, "×"),
      h("p", { class: "under" }, h("span", { class: "kind" }, kindMark(source.kind), source.kind), h("span", {}, carrier(source.carrier_hz)), gradeBadge(quality.grade)),
    ),
    ...noisePart(source, stability),
    ...clockPart(source, at, onTime),
    ...positionPart(source, onCentre),
    h("h3", {}, "Quality"),
    facts([
      ["Rests on", count(quality.contributions, "contribution", "contributions")],
      ["Newest", quality.newest ? `${instant(quality.newest)}, ${age(quality.age_s)} ago` : "–"],
    ]),
    h("h3", {}, "Contributions"),
    contributionPart(contributions),
  ];
}
