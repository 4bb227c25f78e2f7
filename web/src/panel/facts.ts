// Files to download, what was measured, what to be careful about.

import { apiKey, request, type Job } from "../api";
import { byId, bytes, make, words } from "../dom";
import type { Manifest } from "../viewer/manifest";
import { group } from "./group";

const WARNINGS: Record<string, string> = {
  "low-resolution": "The face is small in the photo; details are guessed.",
  "low-confidence": "The face is hard to see; shape and pose are uncertain.",
  "extreme-pose": "The face is turned far away; one side is made up.",
  "under-exposed": "The face is dark; colours are uncertain.",
  "eyes-covered": "The eyes are covered; they are made up.",
  "gaze-not-seen": "Where the eyes look could not be seen.",
  "glasses-removed": "Glasses were taken off; the skin under their frame is made up.",
  "face-covered": "Something covers much of the face; it stays in the maps.",
  "little-seen": "Little of the face is seen; the rest is made up.",
};

export function filesOf(job: Job, manifest: Manifest, erase: () => void): { main: HTMLElement; single: HTMLElement } {
  const total = manifest.files.reduce((sum, file) => sum + file.size, 0);
  const list = make("ul", { class: "files" });
  for (const file of manifest.files) {
    list.append(make("li", {}, link(`${job.links.files}/${file.path}`, file.path, file.path), make("small", {}, bytes(file.size))));
  }
  const main = link(job.links.archive, "avatar.zip", `Download all, ${bytes(total)}`);
  main.className = "button primary big";
  main.id = "download";
  const remove = make("button", { type: "button", class: "danger", id: "delete" }, "Delete");
  remove.addEventListener("click", () => confirm(erase));
  const each = group("Single files", false);
  each.body.append(list);
  const row = make("div", { class: "row" }, main, remove);
  return { main: make("section", { class: "downloads", "aria-label": "Files" }, row, expiry(job)), single: each.element };
}

export function warningsOf(job: Job, manifest: Manifest): HTMLElement[] {
  const codes = new Set([...job.warnings, ...manifest.fit.warnings, ...(manifest.warnings ?? [])]);
  if (!codes.size) return [];
  const rows = [...codes].map((code) => make("li", {}, WARNINGS[code] ?? `${words(code)}.`));
  return [make("section", { class: "note", "aria-label": "To be careful about" }, make("ul", {}, ...rows))];
}

export function facts(job: Job, manifest: Manifest): HTMLElement {
  const { fit, head } = manifest;
  const rows: [string, string][] = [
    ["Landmark error", `${fit.landmark_rms_px.toFixed(1)} px`],
    ["Face seen in the photo", `${Math.round(100 * fit.visible_fraction)} %`],
  ];
  const likeness = fit.identity_similarity;
  if (likeness) {
    rows.push(["Likeness", likeness.centred_cosine.toFixed(2)]);
    rows.push(["95 % of other people", `below ${likeness.impostor.centred_cosine_p95.toFixed(2)}`]);
  }
  rows.push(["Vertices", String(head.vertices)], ["Id", job.id]);
  const list = make("dl", { class: "facts" });
  for (const [name, value] of rows) list.append(make("dt", {}, name), make("dd", {}, value));
  const panel = group("Measured", false);
  panel.body.append(list);
  return panel.element;
}

function expiry(job: Job): HTMLElement {
  const date = job.expires_at ? new Date(job.expires_at) : null;
  const known = date && !Number.isNaN(date.getTime());
  const text = known ? `Kept until ${date.toLocaleString([], { dateStyle: "medium", timeStyle: "short" })}.` : "";
  return make("p", { class: "hint" }, text);
}

/** A link cannot send a key; with one, the file is fetched first and handed over from memory. */
function link(url: string, name: string, text: string): HTMLAnchorElement {
  const made = make("a", { href: url, download: name.split("/").pop()! }, text);
  made.addEventListener("click", (event) => {
    if (!apiKey.get() || made.href.startsWith("blob:")) return;
    event.preventDefault();
    byId("live").textContent = `Fetching ${name}`;
    void request(url)
      .then((answer) => answer.blob())
      .then((blob) => {
        made.href = URL.createObjectURL(blob);
        made.click();
      })
      .catch((error: Error) => (byId("view-status").textContent = error.message));
  });
  return made;
}

function confirm(erase: () => void): void {
  const dialog = byId<HTMLDialogElement>("confirm");
  for (const button of dialog.querySelectorAll("button"))
    button.onclick = () => {
      dialog.close();
      if (button.value === "delete") erase();
    };
  dialog.showModal();
}
