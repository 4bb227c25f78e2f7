// Several photos of one person: which was used for what, and which was not used.

import { make } from "../dom";
import type { Manifest, UsedPhoto } from "../viewer/manifest";
import { group } from "./group";

/** Degrees of the head's turn under which a photo counts as one from the front. */
const FRONT = 15;

/** Null where there was one photo. `pictures` are by hash; after a reload there are none. */
export function photosPanel(manifest: Manifest, pictures: Map<string, File>): HTMLElement | null {
  const { photos = [], left_out: leftOut = [] } = manifest;
  if (photos.length + leftOut.length < 2) return null;
  const panel = group(`Photos: ${photos.length} of ${photos.length + leftOut.length} used`, true);
  panel.element.id = "photos";
  const used = photos.map((photo, place) => row(pictures, photo.sha256, side(photo), uses(photo, place === 0)));
  const others = leftOut.map(({ sha256, message }) => row(pictures, sha256, "Not used", message));
  panel.body.append(make("ul", { class: "used" }, ...used, ...others));
  return panel.element;
}

function row(pictures: Map<string, File>, sha256: string, title: string, text: string): HTMLElement {
  const file = pictures.get(sha256);
  const picture = file ? [thumbnail(file)] : [];
  return make("li", {}, ...picture, make("span", {}, make("b", {}, title), make("small", {}, file ? `${file.name}: ${text}` : text)));
}

/** A small picture; of a format that this browser does not show, the name of the format. */
export function thumbnail(file: File): HTMLElement {
  const frame = make("span", { class: "thumb-picture" }, file.name.split(".").pop()!.slice(0, 4).toUpperCase());
  const image = make("img", { alt: file.name });
  image.onload = () => {
    URL.revokeObjectURL(image.src);
    frame.replaceChildren(image);
  };
  image.onerror = () => URL.revokeObjectURL(image.src);
  image.src = URL.createObjectURL(file);
  return frame;
}

/** Turns of more than zero are to the right of the picture, which is the subject's left. */
function side({ camera }: UsedPhoto): string {
  const yaw = Math.round(camera.yaw_pitch_roll_deg[0]);
  if (Math.abs(yaw) < FRONT) return "From the front";
  return `Turned ${Math.abs(yaw)}° to the ${yaw > 0 ? "left" : "right"}`;
}

function uses({ used_for: names, texture_share: share }: UsedPhoto, first: boolean): string {
  const texture = names.includes("texture") ? `${Math.max(1, Math.round(100 * share))} % of the texture` : "not the texture";
  return `shape, ${texture}${first ? "; expression, eyes and hair" : ""}`;
}
