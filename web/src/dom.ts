// Small helpers for elements.

export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as T;
}

type Child = Node | string;

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string | number | boolean> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes))
    if (value !== false) element.setAttribute(name, value === true ? "" : String(value));
  element.append(...children);
  return element;
}

/** A radio button or checkbox inside its label; the class says how it is drawn. */
export function choice(kind: string, input: Record<string, string | boolean>, ...words: Child[]): HTMLLabelElement {
  return make("label", { class: kind }, make("input", { type: "radio", ...input }), make("span", {}, ...words));
}

export function bytes(count: number): string {
  if (count < 1e5) return `${Math.max(1, Math.round(count / 1e3))} kB`;
  return count < 1e7 ? `${(count / 1e6).toFixed(1)} MB` : `${Math.round(count / 1e6)} MB`;
}

export function duration(seconds: number): string {
  if (seconds < 90) return `${Math.max(1, Math.round(seconds))} s`;
  return `${Math.round(seconds / 60)} min`;
}

/** "diffuse_albedo", "jawOpen" and "face-cut-off" as words. */
export function words(name: string): string {
  const text = name.replace(/[_-]+/g, " ").replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase();
  return text.charAt(0).toUpperCase() + text.slice(1);
}

export function hex(data: Uint8Array): string {
  return Array.from(data, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
