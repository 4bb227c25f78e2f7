// Several faces in the photo: the boxes to choose from, on the photo where it is still here.

import { byId, make } from "./dom";
import type { Box } from "./problem";

export function chooseFace(boxes: Box[], photoUrl: string, chosen: (index: number) => void): void {
  const photo = byId<HTMLImageElement>("boxes-photo");
  const field = byId("boxes");
  field.hidden = true;
  field.querySelectorAll("button").forEach((button) => button.remove());
  byId("face-list").replaceChildren(
    ...boxes.map((_, index) => button(index, "button", chosen)),
  );
  byId("faces").hidden = false;
  if (!photoUrl) return;
  photo.onload = () => {
    field.hidden = false;
    for (const [index, box] of boxes.entries()) {
      const [left, top, right, bottom] = box;
      const frame = button(index, "frame", chosen);
      // Over CSSOM, which the content security policy allows, unlike style attributes.
      frame.style.left = `${(100 * left) / photo.naturalWidth}%`;
      frame.style.top = `${(100 * top) / photo.naturalHeight}%`;
      frame.style.width = `${(100 * (right - left)) / photo.naturalWidth}%`;
      frame.style.height = `${(100 * (bottom - top)) / photo.naturalHeight}%`;
      field.append(frame);
    }
    byId("face-list").replaceChildren();
    field.querySelector("button")?.focus();
  };
  photo.src = photoUrl;
}

function button(index: number, kind: string, chosen: (index: number) => void): HTMLButtonElement {
  const made = make("button", { type: "button", class: kind, "aria-label": `Face ${index + 1}` }, make("span", {}, `${index + 1}`));
  made.addEventListener("click", () => chosen(index));
  return made;
}
