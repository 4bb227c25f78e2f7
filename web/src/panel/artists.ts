// For artists: the maps, the mesh, the numbers, every file.

import type { Job } from "../api";
import { bytes, choice, make } from "../dom";
import type { Manifest } from "../viewer/manifest";
import type { MapStore } from "../viewer/maps";
import type { HeadScene } from "../viewer/scene";
import { fileLink } from "./downloads";
import { group } from "./group";
import { mapsPart } from "./maps";

/** Without a scene (no WebGL) the numbers and the files only. */
export function artistsPanel(
  job: Job,
  manifest: Manifest,
  shown: { scene: HeadScene; store: MapStore } | null,
  signal: AbortSignal,
): HTMLElement {
  const panel = group("For artists", false);
  panel.element.id = "artists";
  if (shown) panel.body.append(mapsPart(shown.scene, shown.store, signal), wireframe(shown.scene));
  panel.body.append(part("measured", "Measured", numbers(job, manifest)), part("files", "Single files", files(job, manifest)));
  return panel.element;
}

function wireframe(scene: HeadScene): HTMLElement {
  const label = choice("switch", { type: "checkbox", id: "wireframe" }, "Wireframe");
  label.addEventListener("change", () => scene.wireframe((label.control as HTMLInputElement).checked));
  return label;
}

function part(id: string, title: string, content: HTMLElement): HTMLElement {
  return make("details", { class: "more", id }, make("summary", {}, title), content);
}

function numbers(job: Job, manifest: Manifest): HTMLElement {
  const { fit, head } = manifest;
  const rows: [string, string][] = [];
  if (fit) {
    rows.push(["Landmark error", `${fit.landmark_rms_px.toFixed(1)} px`]);
    if (fit.landmark_rms_iod !== undefined) rows.push(["of the eyes' distance", `${(100 * fit.landmark_rms_iod).toFixed(1)} %`]);
    rows.push(["Face seen in the photo", `${Math.round(100 * fit.visible_fraction)} %`]);
  }
  const likeness = fit?.identity_similarity;
  if (likeness) {
    rows.push(["Likeness (cosine)", likeness.centred_cosine.toFixed(2)]);
    rows.push(["95 % of other people", `below ${likeness.impostor.centred_cosine_p95.toFixed(2)}`]);
  }
  rows.push(["Vertices", String(head.vertices)], ["Id", job.id]);
  const list = make("dl", { class: "facts" });
  for (const [name, value] of rows) list.append(make("dt", {}, name), make("dd", {}, value));
  return list;
}

function files(job: Job, manifest: Manifest): HTMLElement {
  const rows = manifest.files.map((file) =>
    make("li", {}, fileLink(`${job.links.files}/${file.path}`, file.path), make("small", {}, bytes(file.size))),
  );
  return make("ul", { class: "files" }, ...rows);
}
