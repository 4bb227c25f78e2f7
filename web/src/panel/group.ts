// A part of the panel that folds.

import { make } from "../dom";

export function group(title: string, open: boolean): { element: HTMLDetailsElement; body: HTMLElement } {
  const body = make("div", { class: "group-body" });
  return { element: make("details", { class: "group", open }, make("summary", {}, title), body), body };
}

export interface Slider {
  row: HTMLElement;
  set: (value: number) => void;
}

export function slider(
  label: string,
  id: string,
  range: { min: number; max: number; step: number; unit?: string },
  value: number,
  changed: (value: number) => void,
): Slider {
  const { min, max, step, unit = "" } = range;
  const input = make("input", { type: "range", id, min, max, step });
  const output = make("output", { for: id });
  const show = () => {
    const text = `${step < 1 ? Number(input.value).toFixed(2) : input.value}${unit}`;
    output.textContent = text;
    input.setAttribute("aria-valuetext", text);
  };
  const set = (to: number) => {
    input.value = String(to);
    show();
  };
  input.addEventListener("input", () => {
    show();
    changed(Number(input.value));
  });
  set(value);
  return { row: make("div", { class: "slider" }, make("label", { for: id }, label), output, input), set };
}
