// What the photo was read wrongly for: hair, eyes and mouth, said by the viewer and made again.

import type { Options } from "../api";
import { chosen, field, offered, pickers } from "../choices";
import { make, words } from "../dom";
import { timeInWords } from "../times";
import type { Manifest } from "../viewer/manifest";
import { group } from "./group";

/** Makes the head again with these options, from the photos of this page or from those that are chosen here. */
export type Again = (options: Options, photos: readonly File[]) => void;

/** `hasPhoto` says whether the page still has the photos; else they are chosen again, as the server has erased them. */
export function correctPanel(manifest: Manifest, hasPhoto: boolean, again: Again, signal: AbortSignal): HTMLElement {
  const panel = group("Correct", false);
  panel.element.id = "correct";
  const before: Options = manifest.options ?? {};
  const files = make("input", { type: "file", id: "correct-photo", multiple: true, required: true, accept: "image/*" });
  const form = make("form", { class: "part pickers" });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const wish = new FormData(form);
    again({ ...before, ...chosen(wish), quality: String(wish.get("quality") ?? before.quality) }, [...(files.files ?? [])]);
  });
  panel.body.append(form);
  void offered(signal).then((offer) => {
    const rows = offer ? pickers(offer.choices, "correct", before, manifest.hair?.probabilities) : [];
    if (!offer || !rows.length) return form.append(make("p", { class: "hint" }, "The server did not say what can be corrected."));
    const levels = offer.levels.map(({ name, expected }) => {
      const time = timeInWords(expected);
      return make("option", { value: name, selected: name === before.quality }, words(name) + (time && `, ${time}`));
    });
    form.append(...rows, field("correct-quality", "Quality", make("select", { id: "correct-quality", name: "quality" }, ...levels), true));
    if (!hasPhoto) form.append(field("correct-photo", "The photo again, as the server has erased it", files, true));
    form.append(make("button", { class: "primary" }, "Make it again"));
  });
  return panel.element;
}
