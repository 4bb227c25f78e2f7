// What can be chosen by hand of a head: before it is made, and again where the photo was read wrongly.

import { headers, type Options } from "./api";
import { make, words } from "./dom";
import { readLevels, type Level } from "./times";

/** Options by name, with the labels of this page; the server says what they can be. */
const PICKERS = { hair: "Hair", hair_colour: "Hair colour", eye_colour: "Eye colour", mouth: "Mouth", wrinkles: "Age of wrinkles" } as const;
type Picker = keyof typeof PICKERS;

const AUTO = "auto";
const LENGTH = "hair_length";

/** What this server offers: levels of quality with their times, formats of photos, names for the pickers. */
export interface Offer {
  levels: Level[];
  formats: string[] | null;
  choices: Partial<Record<Picker, string[]>>;
}

/** GET /v1/quality; null where it says nothing, and the page works without. */
export async function offered(signal?: AbortSignal): Promise<Offer | null> {
  try {
    const answer = await fetch("v1/quality", { headers: headers(), signal });
    if (!answer.ok) return null;
    const told = await answer.json();
    return { levels: readLevels(told), formats: Array.isArray(told.formats) ? told.formats : null, choices: told.choices ?? {} };
  } catch {
    return null;
  }
}

/**
 * A picker for each option that the server has names for, and one for the length of the hair.
 *
 * `before` is what stands there first, `sure` how likely each kind of hair was found to be, `prefix` begins the ids.
 */
export function pickers(choices: Offer["choices"], prefix: string, before: Options = {}, sure: Record<string, number> = {}): HTMLElement[] {
  const rows = (Object.entries(PICKERS) as [Picker, string][]).flatMap(([name, title]) => {
    const options = choices[name]?.map((value) => {
      const share = name === "hair" ? (sure[value] ?? 0) : 0;
      const text = value === AUTO ? "As in photo" : words(value) + (share > 0.02 ? ` (${Math.round(100 * share)} %)` : "");
      return make("option", { value, selected: value === (before[name] ?? AUTO) }, text);
    });
    return options ? [field(`${prefix}-${name}`, title, make("select", { id: `${prefix}-${name}`, name }, ...options))] : [];
  });
  if (!rows.length) return rows;
  const id = `${prefix}-length`;
  const length = make("input", { type: "number", id, name: LENGTH, min: 1, max: 1200, step: 1, placeholder: "As in photo", value: before[LENGTH] ?? "" });
  return [...rows, field(id, "Hair's length, mm", length)];
}

/** What the pickers of a form stand at; what is as in the photo is undefined, so that it undoes an earlier choice. */
export function chosen(form: FormData): Options {
  const wish: Options = {};
  for (const name of Object.keys(PICKERS) as Picker[]) {
    const value = form.get(name);
    wish[name] = value && value !== AUTO ? String(value) : undefined;
  }
  return { ...wish, [LENGTH]: Number(form.get(LENGTH)) || undefined };
}

export function field(id: string, title: string, input: HTMLElement, wide = false): HTMLElement {
  return make("div", { class: wide ? "field wide" : "field" }, make("label", { for: id }, title), input);
}
