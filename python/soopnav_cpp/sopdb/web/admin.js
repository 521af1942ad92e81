// What administrators see: contributions in quarantine, with release and reject, and the audit trail.

import { byId, h, say } from "./dom.js";
import { carrier, instant } from "./format.js";
import { request } from "./api.js";

const AUDIT_ROWS = 50;

function quarantineCard(entry, act) {
  const { characterization: body } = entry;
  const decide = (verb, done) => {
    const button = h("button", { type: "button", class: verb === "release" ? "primary" : "danger" }, verb === "release" ? "Release" : "Reject");
    button.addEventListener("click", async () => {
      for (const other of card.querySelectorAll("button")) other.disabled = true;
      await act(entry, verb, done);
    });
    return button;
  };
  const heading = h("h3", { tabindex: "-1" }, body.source.name);
  const card = h(
    "article",
    { class: "card" },
    heading,
    h("p", { class: "under" }, `${body.source.kind}, ${carrier(body.source.carrier_hz)}, from ${body.provenance.receiver}, ${instant(entry.received)}`),
    h("ul", { class: "reasons" }, entry.reasons.map((reason) => h("li", {}, reason))),
    h("details", {}, h("summary", {}, "What it says"), h("pre", { tabindex: "0" }, JSON.stringify(body, null, 2))),
    h("div", { class: "buttons" }, decide("release", "released"), decide("reject", "rejected")),
  );
  return card;
}

/** Loads both lists. `onFailure` gets what the requests throw. */
export async function showAdministration(onFailure) {
  const quarantine = byId("quarantine");
  const audit = byId("audit");
  quarantine.setAttribute("aria-busy", "true");
  try {
    const [held, trail] = await Promise.all([
      request("v1/characterizations", { parameters: { status: "quarantined", limit: 100 } }),
      request("v1/audit", { parameters: { limit: AUDIT_ROWS } }),
    ]);
    const entries = held.contributions;
    const act = async (entry, verb, done) => {
      try {
        await request(`v1/characterizations/${encodeURIComponent(entry.id)}/${verb}`, { method: "POST" });
        say(`${entry.characterization.source.name}: ${done}.`);
      } catch (error) {
        onFailure(error);
      }
      await showAdministration(onFailure);
      byId("quarantine-title").focus();
    };
    quarantine.replaceChildren(
      ...(entries.length
        ? entries.map((entry) => quarantineCard(entry, act))
        : [h("p", { class: "empty" }, "Nothing is in quarantine.")]),
    );
    audit.replaceChildren(
      h(
        "table",
        { class: "audit" },
        h("caption", { class: "visually-hidden" }, "Audit trail, newest first"),
        h("thead", {}, h("tr", {}, ["When", "Who", "What", "Outcome"].map((text) => h("th", { scope: "col" }, text)))),
        h(
          "tbody",
          {},
          trail.entries.map((entry) =>
            h("tr", {}, [instant(entry.at), entry.actor, [entry.action, entry.target].filter(Boolean).join(" "), entry.outcome].map((text) => h("td", {}, text))),
          ),
        ),
      ),
    );
  } catch (error) {
    quarantine.replaceChildren();
    audit.replaceChildren();
    onFailure(error);
  } finally {
    quarantine.removeAttribute("aria-busy");
  }
}
