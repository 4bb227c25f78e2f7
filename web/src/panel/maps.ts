// Switches of the maps: lit by all of them, or one as it is. Part of "For artists".

import { byId, bytes, choice, make, words } from "../dom";
import type { MapStore } from "../viewer/maps";
import type { HeadScene } from "../viewer/scene";
import { MapSurface, PLAIN, type Surface } from "../viewer/skin";

const LEGENDS: Record<string, [string, string][]> = {
  confidence: [
    ["seen", "Seen in the photo"],
    ["mirrored", "Mirrored"],
    ["made-up", "Made up"],
  ],
  shape_normal: [
    ["red", "To the subject's left"],
    ["green", "Up"],
    ["blue", "Forward"],
  ],
};

const TITLES: Record<string, string> = {
  diffuse_normal: "Diffuse normals",
  specular_normal: "Specular normals",
  shape_normal: "Shape normals",
};

const ABOUT: Record<string, string> = {
  lit: "Under the light, which you can move",
  texture: "Colour with the photo's light in it",
  diffuse_albedo: "Colour without light",
  specular_albedo: "Strength of the gloss",
  diffuse_normal: "Normals for light inside the skin",
  specular_normal: "Normals of pores and wrinkles",
  displacement: "Height over the mesh",
  confidence: "What the photo showed",
  shape_normal: "Normals of the fitted head",
};

export function mapsPart(scene: HeadScene, store: MapStore, signal: AbortSignal): HTMLElement {
  const part = make("div", { class: "part" });
  const list = make("div", { class: "choices maps", role: "radiogroup", "aria-label": "What the head shows" });
  const about = make("p", { class: "hint" });
  const lit = litSwitches(store);
  const status = byId("view-status");
  let turn = 0;

  const apply = async () => {
    const mine = ++turn;
    const view = list.querySelector<HTMLInputElement>("input:checked")!.value;
    lit.box.hidden = view !== "lit";
    const map = store.entry(view);
    about.textContent = [ABOUT[view] ?? map?.coding.meaning, map && `${map.width} × ${map.height}, ${map.bits} bits, ${bytes(map.size)}`]
      .filter(Boolean)
      .join("; ");
    try {
      status.textContent = "";
      const slow = window.setTimeout(() => (status.textContent = `Loading ${sizeOf(store, view, lit.chosen())}`), 250);
      const wear = await (view === "lit" ? surfaceOf(store, lit.chosen(), signal) : mapOf(store, view, signal)).finally(() =>
        window.clearTimeout(slow),
      );
      if (mine !== turn) return; // another switch was faster
      status.textContent = "";
      legend(view);
      if ("colour" in wear) scene.wear(wear);
      else scene.inspect(wear.make);
      byId("canvas").dataset.shows = view;
    } catch (error) {
      if (mine === turn && !signal.aborted) status.textContent = `The map could not be shown: ${(error as Error).message}`;
    }
  };

  list.append(choice("choice", { name: "view", value: "lit", checked: true }, "Lit"));
  for (const { role: value } of store.maps) list.append(choice("choice", { name: "view", value }, TITLES[value] ?? words(value)));
  part.append(list, about, lit.box);
  part.addEventListener("change", () => void apply());
  void apply();
  return part;
}

interface Chosen {
  colour: string;
  specular: boolean;
  normals: boolean;
}

function litSwitches(store: MapStore): { box: HTMLElement; chosen: () => Chosen } {
  const colours = ["diffuse_albedo", "texture"].filter((role) => store.entry(role));
  const select = make("select", { id: "colour" });
  for (const role of colours) select.append(make("option", { value: role }, words(role)));
  select.append(make("option", { value: "" }, "Clay"));
  const known = colours.find((role) => store.light(role));
  if (known) select.value = known;
  const box = make("div", { class: "lit" }, make("label", { class: "field" }, make("span", {}, "Colour from"), select));
  const specular = toggle(box, store, "use-specular", "Gloss from its map", ["specular_albedo"]);
  const normals = toggle(box, store, "use-normals", "Pores and wrinkles", ["specular_normal", "diffuse_normal"]);
  return {
    box,
    chosen: () => ({ colour: select.value, specular: specular?.checked ?? false, normals: normals?.checked ?? false }),
  };
}

function toggle(box: HTMLElement, store: MapStore, id: string, label: string, roles: string[]): HTMLInputElement | null {
  const there = roles.filter((role) => store.entry(role));
  if (!there.length) return null;
  const size = there.reduce((sum, role) => sum + store.entry(role)!.size, 0);
  const made = choice("switch", { type: "checkbox", id, checked: there.every((role) => store.light(role)) }, label);
  made.append(make("small", {}, bytes(size)));
  box.append(made);
  return made.control as HTMLInputElement;
}

async function surfaceOf(store: MapStore, chosen: Chosen, signal: AbortSignal): Promise<Surface> {
  const normalRoles = ["specular_normal", "diffuse_normal"].filter((role) => chosen.normals && store.entry(role));
  const [first, second] = normalRoles;
  const twin = second && store.entry(second)!.frame === store.entry(first!)!.frame;
  const [colour, specular, normal, diffuseNormal, coding] = await Promise.all([
    chosen.colour ? store.texture(chosen.colour, "srgb", signal) : null,
    chosen.specular ? store.texture("specular_albedo", "data", signal) : null,
    first ? store.texture(first, "data", signal) : null,
    twin ? store.texture(second, "data", signal) : null,
    first ? store.coding(first, signal) : PLAIN.normalCoding,
  ]);
  const objectSpace = first !== undefined && store.entry(first)!.frame === "object";
  return { colour, specular, normal, diffuseNormal, normalCoding: coding, objectSpace };
}

async function mapOf(store: MapStore, role: string, signal: AbortSignal): Promise<{ make: () => MapSurface }> {
  // Codes go to the screen as they are: decoded as sRGB, then coded again by the renderer.
  const texture = await store.texture(role, role === "confidence" ? "data" : "srgb", signal);
  return { make: () => new MapSurface(texture, role) };
}

function legend(view: string): void {
  const rows = LEGENDS[view] ?? [];
  byId("legend").replaceChildren(...rows.map(([kind, text]) => make("li", { class: kind }, text)));
  byId("legend").hidden = !rows.length;
}

function sizeOf(store: MapStore, view: string, chosen: Chosen): string {
  const normals = chosen.normals ? ["specular_normal", "diffuse_normal"] : [];
  const roles = view === "lit" ? [chosen.colour, chosen.specular ? "specular_albedo" : "", ...normals] : [view];
  return bytes(roles.reduce((sum, role) => sum + (store.entry(role)?.size ?? 0), 0));
}
