// The photo and the options.

import { headers, type Options } from "./api";
import { byId, make, words } from "./dom";
import type { Problem } from "./problem";
import { noteOnTimes, readLevels, timeInWords, withoutReflectance, type Expected, type Level } from "./times";

const USUAL = "standard";
const QUICK = "draft";

/** Levels of quality that this page has words for; a newer server's others are shown by name. */
const ABOUT: Record<string, string> = {
  draft: "A quick look, small maps",
  standard: "Maps for close-ups",
  high: "16-bit normals, fine mesh",
  reference: "Full precision, to compare",
};

/** Names of formats by what the server calls them. */
const FORMATS: Record<string, string> = { jpeg: "JPEG", png: "PNG", webp: "WebP", heic: "HEIC" };

/** The format of a file by its first bytes; null where it is none of these. */
function formatOf(start: Uint8Array): string | null {
  const text = String.fromCharCode(...start);
  if (text.startsWith("\xff\xd8\xff")) return "jpeg";
  if (text.startsWith("\x89PNG")) return "png";
  if (text.startsWith("RIFF") && text.slice(8, 12) === "WEBP") return "webp";
  return text.slice(4, 8) === "ftyp" && /^(hei[cxms]|mif1)/.test(text.slice(8)) ? "heic" : null;
}

const FAST = ["texture", "confidence", "shape_normal"];
const MAPS = ["diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "displacement", ...FAST];

/** Photos of one person that the service takes. */
const MOST_PHOTOS = 24;

export class Intake {
  photos: File[] = [];
  photoUrl = "";
  private thumbs: string[] = [];
  private levels: Level[] = [];

  private formats = Object.keys(FORMATS);

  /** `refused` is told of a file that is no photo that can be read. */
  constructor(
    private readonly changed: () => void,
    private readonly refused: (problem: Problem) => void,
  ) {
    const drop = byId("drop");
    for (const id of ["file", "camera"]) {
      const input = byId<HTMLInputElement>(id);
      input.addEventListener("change", () => {
        // Another one from the camera joins those that are there: front, then turned left, then right.
        const before = id === "camera" ? this.photos : [];
        if (input.files?.length) void this.choose([...input.files], before);
        input.value = ""; // the same file again is a change too
      });
    }
    for (const type of ["dragover", "dragleave", "drop"] as const)
      document.addEventListener(type, (event) => {
        if (byId("intake").hidden) return;
        event.preventDefault(); // a photo dropped beside the field would replace the page
        drop.classList.toggle("over", type === "dragover");
        const files = type === "drop" ? event.dataTransfer?.files : undefined;
        if (files?.length) void this.choose([...files]);
      });
    document.addEventListener("paste", (event) => {
      const files = byId("intake").hidden ? undefined : event.clipboardData?.files;
      if (files?.length) void this.choose([...files]);
    });
    this.offerMaps();
    byId("intake").addEventListener("change", () => this.tellTime());
    void this.ask();
  }

  /** Takes files if all are photos that this server reads, whatever their names say. */
  async choose(files: readonly File[], before: readonly File[] = []): Promise<void> {
    for (const file of files) {
      const format = formatOf(new Uint8Array(await file.slice(0, 16).arrayBuffer()));
      if (format && this.formats.includes(format)) continue;
      const names = this.formats.map((one) => FORMATS[one] ?? one).join(", ");
      const title = format ? `This server does not read ${FORMATS[format]}` : `${file.name} is not a photo that can be read`;
      this.refused({ title, status: 415, detail: `Choose a ${names} file.` });
      return;
    }
    this.take([...before, ...files]);
  }

  take(files: readonly File[]): void {
    this.photos = files.slice(0, MOST_PHOTOS);
    for (const url of this.thumbs) URL.revokeObjectURL(url);
    this.thumbs = this.photos.map((file) => URL.createObjectURL(file));
    this.photoUrl = this.thumbs[0]!;
    const preview = byId<HTMLImageElement>("preview");
    // A format that this browser cannot show may still be one that the service reads.
    preview.onerror = () => (preview.hidden = true);
    preview.onload = () => (preview.hidden = false);
    preview.src = this.photoUrl;
    byId("drop-words").hidden = true;
    byId("photo-name").hidden = false;
    byId("photo-name").textContent =
      this.photos.length === 1 ? this.photos[0]!.name : `${this.photos.length} photos of one person`;
    this.showThumbs();
    byId("file-label").textContent = "Choose others";
    this.changed();
  }

  /** Small pictures of several photos; one is taken away by its button. */
  private showThumbs(): void {
    const row = byId("thumbs");
    row.hidden = this.photos.length < 2;
    row.replaceChildren(
      ...this.photos.map((file, place) => {
        const button = make("button", { type: "button", "aria-label": `Take ${file.name} away`, title: "Take away" }, "×");
        button.addEventListener("click", () => this.take(this.photos.filter((_, other) => other !== place)));
        return make("span", { class: "thumb" }, make("img", { src: this.thumbs[place]!, alt: file.name }), button);
      }),
    );
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
    const hair = String(form.get("hair") ?? "auto"), colour = String(form.get("hair_colour") ?? "auto");
    if (hair !== "auto") chosen.hair = hair;
    if (colour !== "auto") chosen.hair_colour = colour;
    const length = Number(form.get("hair_length"));
    if (length > 0) chosen.hair_length = length;
    return chosen;
  }

  /** Options of a first try: the quickest level, everything else as usual. */
  quickOptions(): Options {
    return this.levels.some((level) => level.name === QUICK) ? { quality: QUICK } : {};
  }

  /** How long a job with these options is likely to take. */
  expected(options: Options): Expected | null {
    if (options.maps?.every((name) => FAST.includes(name))) return withoutReflectance(this.levels);
    return this.levels.find((level) => level.name === (options.quality ?? USUAL))?.expected ?? null;
  }

  /** How long each quality takes on this server; without an answer its usual one is made. */
  private async ask(): Promise<void> {
    try {
      const answer = await fetch("v1/quality", { headers: headers() });
      if (!answer.ok) return;
      const told = await answer.json();
      this.offer(readLevels(told));
      if (Array.isArray(told.formats)) this.accept(told.formats);
    } catch {
      // The page works without.
    }
  }

  private accept(formats: string[]): void {
    this.formats = formats;
    for (const id of ["file", "camera"])
      byId<HTMLInputElement>(id).accept = formats.map((one) => `image/${one}`).join() + (formats.includes("heic") ? ",image/heif" : "");
    byId("formats").textContent = `${formats.map((one) => FORMATS[one] ?? one).join(", ")}.`;
  }

  private offer(levels: Level[]): void {
    this.levels = levels;
    const usual = levels.find((level) => level.name === USUAL) ?? levels[0];
    byId("quality-choices").replaceChildren(
      ...levels.map((level) => {
        const input = make("input", { type: "radio", name: "quality", value: level.name, checked: level === usual });
        const time = make("span", { class: "time" }, timeInWords(level.expected));
        const about = [ABOUT[level.name], level.size.join("\u00a0×\u00a0")].filter(Boolean).join(", ");
        return make("label", { class: "choice" }, input, make("span", {}, make("b", {}, words(level.name)), time, make("small", {}, about)));
      }),
    );
    byId("quality-note").textContent = noteOnTimes(levels);
    byId("quality").hidden = levels.length < 2;
    const quick = timeInWords(this.expected(this.quickOptions()));
    byId("try-time").textContent = quick ? `Draft quality, ${quick}` : "";
    this.tellTime();
  }

  private tellTime(): void {
    const time = timeInWords(this.expected(this.options()));
    byId("estimate").textContent = time ? `Takes ${time}.` : "";
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
