// What was measured, in words; the numbers are under "For artists".

import { warnings } from "../../../service/data/words.json";
import type { Job } from "../api";
import { make, words } from "../dom";
import type { Fit, Hair, Likeness, Manifest } from "../viewer/manifest";

/** Distance of the identity network under which two photos count as one person (King 2017, dlib). */
const SAME_PERSON = 0.6;
/** Three quarters of it; the project's own photos lie at 0.38 on average (README, `python -m benchmarks.photos`). */
const VERY_LIKE = 0.45;

/** Landmark error over the distance of the eyes; rendered photos of unseen heads have 0.013 (README). */
const CLOSE = 0.035;
const FAIR = 0.06;

/** Overlap of the hair's outline with that in the photo from which on it counts as alike. */
const HAIR_LIKE = 0.7;

export function summary(job: Job, manifest: Manifest): HTMLElement {
  const section = make("section", { class: "summary", "aria-labelledby": "summary-title" });
  const { hair, options } = manifest;
  const verdicts = [faceInWords(manifest.fit?.identity_similarity ?? null)];
  if (hair?.kind) verdicts.push(hairInWords(hair, (options?.hair ?? "auto") !== "auto"));
  const title = make("h2", { id: "summary-title" }, ...verdicts.map((text) => make("span", {}, text)));
  section.append(title, make("p", {}, manifest.fit ? sentences(manifest.fit) : "Made from a texture and a mesh."));
  const codes = new Set([...job.warnings, ...(manifest.fit?.warnings ?? []), ...(manifest.warnings ?? []), ...(manifest.hair?.doubts ?? [])]);
  const rows = [...codes].map((code) => make("li", {}, (warnings as Record<string, string>)[code] ?? `${words(code)}.`));
  if (rows.length) section.append(make("ul", { class: "note", "aria-label": "To be careful about" }, ...rows));
  return section;
}

/** Face and hair apart: the network that compares faces sees no hair. */
function faceInWords(likeness: Likeness | null): string {
  if (!likeness) return "The head is ready";
  if (likeness.distance <= VERY_LIKE) return "Face: very like the photo";
  if (likeness.distance <= SAME_PERSON) return "Face: like the photo";
  return likeness.distance <= likeness.impostor.distance_p05 ? "Face: somewhat like the photo" : "Face: not much like the photo";
}

function hairInWords({ kind, agreement, doubts }: Hair, asked: boolean): string {
  const name = words(kind).toLowerCase();
  if (asked) return `Hair: ${name}, as chosen`;
  if (!agreement) return `Hair: ${name}, not compared`;
  const like = agreement >= HAIR_LIKE && !doubts.length ? "like the photo" : agreement >= HAIR_LIKE / 2 ? "roughly like the photo" : "unlike the photo";
  return `Hair: ${name}, ${like}`;
}

function sentences(fit: Fit): string {
  const error = fit.landmark_rms_iod;
  const shape =
    error === undefined
      ? ""
      : error <= CLOSE
        ? "The shape follows the face closely. "
        : error <= FAIR
          ? "The shape follows the face fairly well. "
          : "The shape follows the face loosely. ";
  return `${shape}${seen(fit.visible_fraction)}; the rest of the head is made up to match.`;
}

function seen(share: number): string {
  if (share >= 0.8) return "The photo shows nearly all of the face";
  if (share >= 0.55) return "The photo shows most of the face";
  return share >= 0.35 ? "The photo shows about half of the face" : "The photo shows little of the face";
}
