// Sliders of the ARKit blendshapes.

import { make, words } from "../dom";
import type { HeadScene } from "../viewer/scene";
import { group, slider, type Slider } from "./group";

const REGIONS: [string, RegExp][] = [
  ["Brows", /^brow/],
  ["Eyes", /^eye/],
  ["Cheeks and nose", /^(cheek|nose)/],
  ["Jaw", /^jaw/],
  ["Mouth", /^mouth/],
  ["Tongue", /^tongue/],
  ["Other", /./],
];

export function expressionPanel(scene: HeadScene): HTMLElement {
  const names = scene.blendshapes();
  const panel = group("Expression", false);
  if (!names.length) {
    panel.body.append(make("p", { class: "hint" }, "This head has no blendshapes."));
    return panel.element;
  }
  const sliders = new Map<string, Slider>();
  const all = (weights: Record<string, number>) => {
    scene.express(weights);
    for (const [name, one] of sliders) one.set(weights[name] ?? 0);
  };
  panel.body.append(
    make("div", { class: "row" }, button("As in the photo", () => all(scene.photoExpression)), button("Neutral", () => all({}))),
  );
  // Fifty sliders cost time that most visitors do not need.
  panel.element.addEventListener("toggle", () => {
    if (sliders.size) return;
    const left = new Set(names);
    for (const [title, pattern] of REGIONS) {
      const mine = [...left].filter((name) => pattern.test(name));
      if (!mine.length) continue;
      const rows = mine.map((name) => {
        left.delete(name);
        const one = slider(words(name), `shape-${name}`, { min: 0, max: 1, step: 0.01 }, scene.expression[name] ?? 0, (value) =>
          scene.express({ ...scene.expression, [name]: value }),
        );
        sliders.set(name, one);
        return one.row;
      });
      panel.body.append(make("fieldset", {}, make("legend", {}, title), ...rows));
    }
  });
  return panel.element;
}

function button(text: string, pressed: () => void): HTMLButtonElement {
  const made = make("button", { type: "button" }, text);
  made.addEventListener("click", pressed);
  return made;
}
