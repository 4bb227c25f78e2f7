// The photo and the options.

import { headers, type Options } from "./api";
import { byId, duration, make, words } from "./dom";

const USUAL = "standard";

/** Levels of quality that this page has words for; a newer server's others are shown by name. */
const ABOUT: Record<string, string> = {
  draft: "a quick look",
  high: "16-bit normals, fine mesh",
  reference: "full precision",
};

const FAST = ["texture", "confidence", "shape_normal"];
const MAPS = ["diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "displacement", ...FAST];

interface Level {
  name: string;
  size: number[];
  seconds: number | null;
}

export class Intake {
  photo: File | null = null;
  photoUrl = "";
  constructor(private readonly changed: () => void) {
    const drop = byId("drop");
    for (const id of ["file", "camera"]) {
      const input = byId<HTMLInputElement>(id);
      input.addEventListener("change", () => {
        const file = input.files?.[0];
        if (file) this.take(file);
        input.value = ""; // the same file again is a change too
      });
    }
    for (const type of ["dragover", "dragleave", "drop"] as const)
      document.addEventListener(type, (event) => {
        if (byId("intake").hidden) return;
        event.preventDefault(); // a photo dropped beside the field would replace the page
        drop.classList.toggle("over", type === "dragover");
        const file = type === "drop" ? event.dataTransfer?.files[0] : undefined;
        if (file) this.take(file);
      });
    document.addEventListener("paste", (event) => {
      const file = byId("intake").hidden ? undefined : event.clipboardData?.files[0];
      if (file) this.take(file);
    });
    this.offerMaps();
    void this.ask();
  }

  take(file: File): void {
    URL.revokeObjectURL(this.photoUrl);
    this.photo = file;
    this.photoUrl = URL.createObjectURL(file);
    const preview = byId<HTMLImageElement>("preview");
    // A format that this browser cannot show may still be one that the service reads.
    preview.onerror = () => (preview.hidden = true);
    preview.onload = () => (preview.hidden = false);
    preview.src = this.photoUrl;
    byId("drop-words").hidden = true;
    byId("photo-name").hidden = false;
    byId("photo-name").textContent = file.name;
    byId("file-label").textContent = "Choose another";
    this.changed();
  }

  options(): Options {
    const form = new FormData(byId<HTMLFormElement>("intake"));
    const chosen: Options = {};
    const quality = form.get("quality");
    if (typeof quality === "string") chosen.quality = quality;
    const which = form.get("which");
    if (which === "fast") chosen.maps = FAST;
    if (which === "some") chosen.maps = form.getAll("maps").map(String);
    if (form.get("face") === "largest") chosen.face = "largest";
    return chosen;
  }

  /** How long each quality takes on this server; without an answer its usual one is made. */
  private async ask(): Promise<void> {
    try {
      const answer = await fetch("v1/quality", { headers: headers() });
      if (answer.ok) this.offer(read(await answer.json()));
    } catch {
      // The page works without.
    }
  }

  private offer(levels: Level[]): void {
    const usual = levels.find((level) => level.name === USUAL) ?? levels[0];
    byId("quality-choices").replaceChildren(
      ...levels.map((level) => {
        const input = make("input", { type: "radio", name: "quality", value: level.name, checked: level === usual });
        const time = level.seconds === null ? "" : `about ${duration(level.seconds)}`;
        const about = [time, ABOUT[level.name], level.size.join("\u00a0×\u00a0")].filter(Boolean).join("; ");
        const text = make("span", {}, make("b", {}, words(level.name)), make("small", {}, about));
        return make("label", { class: "choice" }, input, text);
      }),
    );
    byId("quality").hidden = levels.length < 2;
  }

  private offerMaps(): void {
    byId("maps-choices").append(
      ...MAPS.map((name) => {
        const input = make("input", { type: "checkbox", name: "maps", value: name, checked: true });
        return make("label", { class: "check" }, input, make("span", {}, words(name)));
      }),
    );
    byId("maps").addEventListener("change", () => {
      const which = new FormData(byId<HTMLFormElement>("intake")).get("which");
      byId("maps-choices").hidden = which !== "some";
    });
  }
}

/** Levels with the median time that jobs of their size took here. */
function read(content: unknown): Level[] {
  const given = (typeof content === "object" && content !== null ? content : {}) as Record<string, unknown>;
  const rows = (name: string) => (Array.isArray(given[name]) ? given[name] : []) as Record<string, unknown>[];
  return rows("levels").map((level) => {
    const size = (Array.isArray(level.size) ? level.size : []).map(Number);
    const measured = rows("items").find((item) => item.quality === level.name && String(item.size) === String(size));
    return { name: String(level.name), size, seconds: Number.isFinite(measured?.median_s) ? Number(measured!.median_s) : null };
  });
}
