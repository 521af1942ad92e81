// Requests to the service. Failures become sentences; a token lives in sessionStorage and nowhere else.

const TOKEN = "sopdb-token";
const WAIT_S = 20;

/** What went wrong, in words a reader can act on. `kind` is offline, token, role, rate, missing, request or server. */
export class Failure extends Error {
  constructor(kind, sentence, retryAfterS = null) {
    super(sentence);
    this.kind = kind;
    this.retryAfterS = retryAfterS;
  }
}

export function token() {
  try {
    return sessionStorage.getItem(TOKEN);
  } catch {
    return null; // storage switched off: reading works without it
  }
}

export function keepToken(text) {
  try {
    if (text) sessionStorage.setItem(TOKEN, text);
    else sessionStorage.removeItem(TOKEN);
  } catch {
    throw new Failure("token", "This browser keeps no session storage, so a token cannot be used here.");
  }
}

/** The sentence of a refusal, and the fields that it names. */
function detailOf(body) {
  if (!body || typeof body.detail !== "string") return "";
  const fields = Array.isArray(body.errors) ? body.errors.map((entry) => `${entry.field}: ${entry.message}`) : [];
  return [body.detail, ...fields.filter((text) => !body.detail.includes(text))].join("; ");
}

async function failure(response, hadToken) {
  let body = null;
  try {
    body = await response.json();
  } catch {
    // An answer that is not the service's own, a proxy's page for one: the status says enough.
  }
  const detail = detailOf(body);
  switch (response.status) {
    case 401:
      return new Failure(
        "token",
        hadToken
          ? "The token was refused: it is wrong, has expired or was revoked. Enter another one."
          : "This service answers only with a token. Enter one to go on.",
      );
    case 403:
      return new Failure("role", "This token's role does not allow that. A token of an administrator is needed.");
    case 404:
      return new Failure("missing", "The service does not know this source. It may have been withdrawn.");
    case 429: {
      const wait = Number(response.headers.get("Retry-After"));
      const seconds = Number.isFinite(wait) && wait > 0 ? Math.ceil(wait) : 5;
      return new Failure("rate", "Too many requests: the service asks to wait.", seconds);
    }
    default:
      if (response.status >= 500) {
        return new Failure("server", `The service has a fault of its own (${response.status}).`, 10);
      }
      return new Failure("request", `The service did not accept the request${detail ? `: ${detail}` : "."}`);
  }
}

/**
 * The JSON of an answer; throws Failure otherwise. `path` is relative to the page, so that the service can live below
 * any path of a proxy. `parameters` whose value is empty are left out.
 */
export async function request(path, { parameters = {}, method = "GET", body = null, signal = null } = {}) {
  const query = new URLSearchParams();
  for (const [name, value] of Object.entries(parameters)) {
    if (value !== null && value !== undefined && value !== "") query.set(name, value);
  }
  const text = query.toString();
  const given = token();
  const headers = { Accept: "application/json" };
  if (given) headers.Authorization = `Bearer ${given}`;
  if (body !== null) headers["Content-Type"] = "application/json";
  const timer = AbortSignal.timeout(WAIT_S * 1000);
  let response;
  try {
    response = await fetch(text ? `${path}?${text}` : path, {
      method,
      headers,
      body: body === null ? undefined : JSON.stringify(body),
      signal: signal ? AbortSignal.any([signal, timer]) : timer,
      credentials: "omit",
      cache: "no-cache", // asks with the ETag it has, and shows nothing older than the service's answer
    });
  } catch (error) {
    if (signal?.aborted) throw error;
    throw new Failure("offline", "The service does not answer: it may be down, or this device offline.", 10);
  }
  if (!response.ok) throw await failure(response, Boolean(given));
  if (response.status === 204) return null;
  try {
    return await response.json();
  } catch {
    throw new Failure("server", "The service sent an answer that is not JSON. A proxy between may be at fault.", 10);
  }
}
