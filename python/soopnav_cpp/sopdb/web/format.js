// Numbers as people read them. Every function takes SI units and returns text; null and NaN become a dash.

const DASH = "–";
const MINUS = "\u2212";
const PREFIXES = [
  [1, ""],
  [1e-3, "m"],
  [1e-6, "µ"],
  [1e-9, "n"],
  [1e-12, "p"],
  [1e-15, "f"],
];
const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

function known(value) {
  return typeof value === "number" && Number.isFinite(value);
}

function fixed(value, digits) {
  return value.toFixed(Math.min(Math.max(digits, 0), 12)).replace("-", MINUS);
}

/** 10 to the power of an integer, with superscript digits. */
export function powerOfTen(exponent) {
  const digits = [...String(Math.abs(exponent))].map((digit) => SUPERSCRIPTS[Number(digit)]).join("");
  return `10${exponent < 0 ? "⁻" : ""}${digits}`;
}

/** `2.6·10⁻²²`, with `digits` after the point. */
export function scientific(value, digits = 1) {
  if (!known(value)) return DASH;
  if (value === 0) return "0";
  let exponent = Math.floor(Math.log10(Math.abs(value)));
  let mantissa = value / 10 ** exponent;
  if (Math.abs(Number(mantissa.toFixed(digits))) >= 10) {
    mantissa /= 10;
    exponent += 1;
  }
  return exponent === 0 ? fixed(mantissa, digits) : `${fixed(mantissa, digits)}·${powerOfTen(exponent)}`;
}

/** Seconds with their standard deviation in one prefix: `−412.7 ± 8.2 ns`. The deviation sets the digits. */
export function secondsWithSigma(value, sigma) {
  if (!known(value)) return DASH;
  const scale = Math.max(Math.abs(value), known(sigma) ? sigma : 0);
  const [factor, prefix] = PREFIXES.find(([least]) => scale >= least) ?? PREFIXES[PREFIXES.length - 1];
  if (!known(sigma) || sigma <= 0) return `${fixed(value / factor, 3)} ${prefix}s`;
  const digits = 1 - Math.floor(Math.log10(sigma / factor));
  return `${fixed(value / factor, digits)} ± ${fixed(sigma / factor, digits)} ${prefix}s`;
}

/** A dimensionless number with its deviation: `(1.23 ± 0.04)·10⁻¹⁰`. */
export function fractionWithSigma(value, sigma) {
  if (!known(value)) return DASH;
  const scale = Math.max(Math.abs(value), known(sigma) ? sigma : 0);
  if (scale === 0) return "0";
  const exponent = Math.floor(Math.log10(scale));
  const factor = 10 ** exponent;
  if (!known(sigma) || sigma <= 0) return scientific(value, 2);
  const digits = 1 - Math.floor(Math.log10(sigma / factor));
  return `(${fixed(value / factor, digits)} ± ${fixed(sigma / factor, digits)})·${powerOfTen(exponent)}`;
}

/** A carrier: `881.52 MHz`, `1.575 42 GHz` stays in MHz so that a column can be compared. */
export function carrier(hz) {
  if (!known(hz)) return DASH;
  return `${(hz / 1e6).toFixed(6).replace(/\.?0+$/, "")} MHz`;
}

export function metres(value) {
  if (!known(value)) return DASH;
  if (Math.abs(value) >= 10e3) return `${fixed(value / 1e3, value >= 100e3 ? 0 : 1)} km`;
  return `${fixed(value, value < 10 ? 1 : 0)} m`;
}

/** `52.20511° N, 0.12184° E`; digits follow the standard deviation where there is one. */
export function place(latitude, longitude, sigma = null) {
  if (!known(latitude) || !known(longitude)) return DASH;
  const digits = known(sigma) && sigma > 0 ? Math.min(Math.max(Math.ceil(-Math.log10(sigma / 1.1e5)), 1), 7) : 4;
  const part = (value, plus, minus) => `${Math.abs(value).toFixed(digits)}° ${value < 0 ? minus : plus}`;
  return `${part(latitude, "N", "S")}, ${part(longitude, "E", "W")}`;
}

/** How long ago: `12 s`, `3 min`, `2.1 h`, `5 d`. */
export function age(seconds) {
  if (!known(seconds)) return DASH;
  const past = Math.max(seconds, 0);
  if (past < 99.5) return `${fixed(past, 0)} s`;
  if (past < 90 * 60) return `${fixed(past / 60, 0)} min`;
  if (past < 36 * 3600) return `${fixed(past / 3600, 1)} h`;
  return `${fixed(past / 86400, past < 10 * 86400 ? 1 : 0)} d`;
}

/** An instant in UTC to the second; the text itself when it is no date. */
export function instant(text) {
  const date = new Date(text);
  return Number.isNaN(date.getTime()) ? String(text ?? DASH) : `${date.toISOString().slice(0, 19).replace("T", " ")} UTC`;
}

/** How far a value with standard deviation `sigma` of its logarithm may be off, 95 %: `× 1.4`. */
export function factor95(sigma) {
  return known(sigma) ? `×/÷ ${Math.exp(1.96 * sigma).toPrecision(2)}` : DASH;
}

export function count(number, one, many) {
  return `${number} ${number === 1 ? one : many}`;
}
