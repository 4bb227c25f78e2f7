// Several faces in the photo: the boxes to choose from. They are counted as the service counts its boxes, all of them.

import { byId, make } from "./dom";
import type { Box } from "./problem";

export function chooseFace(boxes: Box[], file: File, chosen: (index: number) => void): void {
  const photo = byId<HTMLImageElement>("boxes-photo");
  const field = byId("boxes");
  const list = byId("face-list");
  field.hidden = true;
  field.querySelectorAll("button").forEach((old) => old.remove());
  list.replaceChildren();
  byId("faces-help").textContent = `There are ${boxes.length} faces in the photo. Choose the one to make a head of.`;
  byId("faces-title").focus();
  // A format that this browser cannot show may still be one that the service reads.
  photo.onerror = () => list.replaceChildren(...boxes.map((_, index) => button(index, "button", chosen)));
  photo.onload = () => {
    field.hidden = false;
    for (const [index, box] of boxes.entries()) field.append(frame(index, box, photo, chosen));
  };
  URL.revokeObjectURL(photo.src);
  photo.src = URL.createObjectURL(file);
}

function frame(index: number, box: Box, photo: HTMLImageElement, chosen: (index: number) => void): HTMLButtonElement {
  const [left, top, right, bottom] = box;
  const made = button(index, "frame", chosen);
  // Over CSSOM, which the content security policy allows, unlike style attributes.
  made.style.left = `${(100 * left) / photo.naturalWidth}%`;
  made.style.top = `${(100 * top) / photo.naturalHeight}%`;
  made.style.width = `${(100 * (right - left)) / photo.naturalWidth}%`;
  made.style.height = `${(100 * (bottom - top)) / photo.naturalHeight}%`;
  return made;
}

function button(index: number, kind: string, chosen: (index: number) => void): HTMLButtonElement {
  const name = `Face ${index + 1}${index === 0 ? ", the largest" : ""}`;
  const made = make("button", { type: "button", class: kind, "aria-label": name }, make("span", {}, `${index + 1}`));
  made.addEventListener("click", () => chosen(index));
  return made;
}
