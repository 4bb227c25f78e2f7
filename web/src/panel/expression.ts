// Expressions: presets, a loop in which the head looks alive, and a slider for each of the ARKit blendshapes.

import { choice, make, words } from "../dom";
import { Motion, type Weights } from "../viewer/motion";
import type { HeadScene } from "../viewer/scene";
import { group, slider, type Slider } from "./group";
import { PRESETS } from "./presets";

const REGIONS: [string, RegExp][] = [
  ["Brows", /^brow/],
  ["Eyes", /^eye/],
  ["Cheeks and nose", /^(cheek|nose)/],
  ["Jaw", /^jaw/],
  ["Mouth", /^mouth/],
  ["Tongue", /^tongue/],
  ["Other", /./],
];

export function expressionPanel(scene: HeadScene, motion: Motion): HTMLElement {
  const names = scene.blendshapes();
  const panel = group("Expression", true);
  if (!names.length) {
    panel.body.append(make("p", { class: "hint" }, "This head has no blendshapes."));
    return panel.element;
  }
  const sliders = new Map<string, Slider>();
  const chips = chipsOf(scene.photoExpression, (weights) => {
    motion.to(weights);
    for (const [name, one] of sliders) one.set(weights[name] ?? 0);
  });
  const all = slidersOf(names, sliders, motion, () => {
    for (const chip of chips.querySelectorAll("input")) chip.checked = false; // it is nobody's preset any more
  });
  panel.body.append(chips, liveButton(motion), all);
  return panel.element;
}

function chipsOf(photo: Weights, chosen: (weights: Weights) => void): HTMLElement {
  const list = make("div", { class: "chips", role: "radiogroup", "aria-label": "Expression" });
  const choices: typeof PRESETS = [["photo", "As in the photo", photo], ...PRESETS];
  for (const [id, title, weights] of choices) {
    const chip = choice(`chip ${id}`, { name: "preset", value: id, checked: id === "photo" }, title);
    chip.addEventListener("change", () => chosen(weights));
    list.append(chip);
  }
  return list;
}

function liveButton(motion: Motion): HTMLElement {
  const button = make("button", { type: "button", id: "alive", "aria-pressed": "false" }, "Live");
  button.addEventListener("click", () => {
    const on = button.getAttribute("aria-pressed") === "false";
    button.setAttribute("aria-pressed", String(on));
    button.textContent = on ? "Stop" : "Live";
    motion.loop(on);
  });
  return make("div", { class: "row alive" }, button, make("span", { class: "hint" }, "Blinks, looks about, smiles"));
}

function slidersOf(names: string[], sliders: Map<string, Slider>, motion: Motion, moved: () => void): HTMLElement {
  const details = make("details", { class: "more", id: "shapes" }, make("summary", {}, `All ${names.length} shapes`));
  // Fifty sliders cost time that most visitors do not need.
  details.addEventListener("toggle", () => {
    if (sliders.size) return;
    const left = new Set(names);
    for (const [title, pattern] of REGIONS) {
      const mine = [...left].filter((name) => pattern.test(name));
      if (!mine.length) continue;
      const rows = mine.map((name) => {
        left.delete(name);
        const one = slider(words(name), `shape-${name}`, { min: 0, max: 1, step: 0.01 }, motion.rest[name] ?? 0, (value) => {
          motion.set(name, value);
          moved();
        });
        sliders.set(name, one);
        return one.row;
      });
      details.append(make("fieldset", {}, make("legend", {}, title), ...rows));
    }
  });
  return details;
}
