// What the photo was read wrongly for: hair, eyes and mouth, said by the viewer and made again.

import { headers, type Options } from "../api";
import { make, words } from "../dom";
import type { Manifest } from "../viewer/manifest";
import { group } from "./group";

/** Options by name, with the labels of this page; the server says what they can be. */
const PICKERS = { hair: "Hair", hair_colour: "Hair colour", eye_colour: "Eye colour", mouth: "Mouth" } as const;
type Picker = keyof typeof PICKERS;

/** `again` makes the head anew with more options; null where the page no longer has the photo. */
export function correctPanel(manifest: Manifest, again: ((options: Options) => void) | null, signal: AbortSignal): HTMLElement {
  const panel = group("Correct", false);
  panel.element.id = "correct";
  if (!again) {
    panel.body.append(make("p", { class: "hint" }, "The server has erased the photo. Choose it again to have the head made with corrections."));
    return panel.element;
  }
  const before = (manifest.options ?? {}) as Options;
  const form = make("form", { class: "part" });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const wish: Options = {};
    for (const [name, value] of new FormData(form)) if (value && name !== "hair_length") wish[name as Picker] = String(value);
    const length = Number(new FormData(form).get("hair_length"));
    if (length) wish.hair_length = length;
    again(wish);
  });
  panel.body.append(form);
  void fetch("v1/quality", { headers: headers(), signal })
    .then((answer) => answer.json())
    .then(({ choices = {} }: { choices?: Partial<Record<Picker, string[]>> }) => {
      for (const [name, title] of Object.entries(PICKERS) as [Picker, string][])
        if (choices[name]) form.append(picker(name, title, choices[name], String(before[name] ?? "auto"), manifest));
      const length = make("input", { type: "number", id: "correct-length", name: "hair_length", min: 1, max: 1200, step: 1, placeholder: "as it is" });
      if (before.hair_length) length.value = String(before.hair_length);
      form.append(field("correct-length", "Longest hair, mm", length), make("button", { class: "primary" }, "Make it again"));
    })
    .catch(() => form.append(make("p", { class: "hint" }, "The server did not say what can be corrected.")));
  return panel.element;
}

function picker(name: Picker, title: string, values: string[], chosen: string, manifest: Manifest): HTMLElement {
  const sure = name === "hair" ? manifest.hair?.probabilities : undefined;
  const options = values.map((value) => {
    const share = sure?.[value];
    const text = value === "auto" ? "As in the photo" : `${words(value)}${share && share > 0.02 ? ` (${Math.round(100 * share)} %)` : ""}`;
    return make("option", { value: value === "auto" ? "" : value, selected: value === chosen }, text);
  });
  return field(`correct-${name}`, title, make("select", { id: `correct-${name}`, name }, ...options));
}

function field(id: string, title: string, input: HTMLElement): HTMLElement {
  return make("div", { class: "field" }, make("label", { for: id }, title), input);
}
