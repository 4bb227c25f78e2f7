// The photo and the options.

import type { Options } from "./api";
import { guided, hasCamera } from "./camera";
import { chosen, offered, pickers } from "./choices";
import { byId, choice, make, words } from "./dom";
import { thumbnail } from "./panel/photos";
import type { Problem } from "./problem";
import { noteOnTimes, timeInWords, withMorePhotos, withoutReflectance, type Expected, type Level } from "./times";

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
  private levels: Level[] = [];
  private formats = Object.keys(FORMATS);
  private reading: Promise<void> = Promise.resolve();

  /** `refused` is told of files that are no photos that can be read. */
  constructor(
    private readonly changed: () => void,
    private readonly refused: (problem: Problem) => void,
  ) {
    const drop = byId("drop");
    for (const id of ["file", "camera"]) {
      const input = byId<HTMLInputElement>(id);
      input.addEventListener("change", () => {
        void this.choose([...(input.files ?? [])]);
        input.value = ""; // the same file again is a change too
      });
    }
    for (const type of ["dragover", "dragleave", "drop"] as const)
      document.addEventListener(type, (event) => {
        if (byId("intake").hidden) return;
        event.preventDefault(); // a photo dropped beside the field would replace the page
        drop.classList.toggle("over", type === "dragover");
        if (type === "drop") void this.choose([...(event.dataTransfer?.files ?? [])]);
      });
    document.addEventListener("paste", (event) => {
      if (!byId("intake").hidden) void this.choose([...(event.clipboardData?.files ?? [])]);
    });
    byId("guide-open").addEventListener("click", () => void this.guide());
    void hasCamera().then((has) => (byId("guide-open").hidden = !has));
    this.offerMaps();
    byId("intake").addEventListener("change", () => this.tellTime());
    void this.ask();
  }

  /** Takes those files that are photos that this server reads, whatever their names say, beside those of before. */
  choose(files: readonly File[]): Promise<void> {
    this.reading = this.reading.then(() => this.sort(files));
    return this.reading;
  }

  /** Resolved as soon as all files that were chosen have been looked at. */
  ready(): Promise<void> {
    return this.reading;
  }

  private async sort(files: readonly File[]): Promise<void> {
    const good: File[] = [];
    const bad: string[] = [];
    for (const file of files) {
      // A file that has gone since it was chosen has no bytes.
      const start = await file.slice(0, 16).arrayBuffer().catch(() => new ArrayBuffer(0));
      const format = formatOf(new Uint8Array(start));
      if (format && this.formats.includes(format)) good.push(file);
      else bad.push(format ? `${file.name} is ${FORMATS[format]}, which this server does not read` : `${file.name} is not a photo that can be read`);
    }
    if (good.length) this.take([...this.photos, ...good]);
    const names = this.formats.map((one) => FORMATS[one] ?? one).join(", ");
    const others = bad.length > 1 ? `Nor can ${bad.length - 1} more: ${bad.slice(1).join("; ")}. ` : "";
    if (bad.length) this.refused({ title: bad[0]!, status: 415, detail: `${others}Choose ${names} files.` });
  }

  /** These photos, and no others; none empties the field. */
  take(files: readonly File[]): void {
    this.photos = files.filter((file, place) => files.findIndex((other) => same(file, other)) === place).slice(0, MOST_PHOTOS);
    const [first, ...more] = this.photos;
    byId("drop-words").hidden = first !== undefined;
    byId("photo-name").hidden = !first;
    byId("photo-name").textContent = more.length ? `${this.photos.length} photos of one person` : (first?.name ?? "");
    byId("thumbs").replaceChildren(...this.photos.map((file) => this.thumb(file)));
    byId("file-label").textContent = first ? "Add photos" : "Choose photos";
    this.tellTime();
    this.changed();
  }

  /** What is wrong with one of several photos, by the name of its file, which is marked. */
  blamed({ photo, detail = "" }: Problem): string {
    const file = this.photos.length > 1 && photo !== undefined ? this.photos[photo] : undefined;
    if (!file) return detail;
    byId("thumbs").children[photo!]?.classList.add("bad");
    return detail.replace(/^photo \d+ of \d+(?=:)/, file.name);
  }

  private async guide(): Promise<void> {
    try {
      await this.choose(await guided());
    } catch (error) {
      this.refused({ title: "The camera cannot be used", status: 0, detail: (error as Error).message });
    }
  }

  /** A small picture that can be taken away. */
  private thumb(file: File): HTMLElement {
    const button = make("button", { type: "button", "aria-label": `Take ${file.name} away`, title: "Take away" }, "×");
    button.addEventListener("click", () => this.take(this.photos.filter((other) => other !== file)));
    return make("li", {}, thumbnail(file), button);
  }

  options(): Options {
    const form = new FormData(byId<HTMLFormElement>("intake"));
    const wish: Options = chosen(form);
    const quality = form.get("quality");
    if (typeof quality === "string") wish.quality = quality;
    const which = form.get("which");
    if (which === "fast") wish.maps = FAST;
    if (which === "some") wish.maps = form.getAll("maps").map(String);
    if (form.get("face") === "largest") wish.face = "largest";
    return wish;
  }

  /** Whether photo and steps are to be kept, so that corrections take seconds. */
  keeps(): boolean {
    return byId<HTMLInputElement>("keep").checked;
  }

  /** Options of a first try: the quickest level, everything else as usual. */
  quickOptions(): Options {
    return this.levels.some((level) => level.name === QUICK) ? { quality: QUICK } : {};
  }

  /** How long a job with these options is likely to take. */
  expected(options: Options): Expected | null {
    const one = options.maps?.every((name) => FAST.includes(name))
      ? withoutReflectance(this.levels)
      : (this.levels.find((level) => level.name === (options.quality ?? USUAL))?.expected ?? null);
    return withMorePhotos(one, this.photos.length - 1);
  }

  /** What this server offers; without an answer its usual quality is made. */
  private async ask(): Promise<void> {
    const offer = await offered();
    if (!offer) return;
    this.offer(offer.levels);
    if (offer.formats) this.accept(offer.formats);
    byId("looks").append(...pickers(offer.choices, "make"));
    byId("looks").hidden = byId("looks").children.length < 2;
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
        const time = make("span", { class: "time" }, timeInWords(level.expected));
        const about = [ABOUT[level.name], level.size.join("\u00a0×\u00a0")].filter(Boolean).join(", ");
        const input = { name: "quality", value: level.name, checked: level === usual };
        return choice("choice", input, make("b", {}, words(level.name)), time, make("small", {}, about));
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
      ...MAPS.map((value) => choice("check", { type: "checkbox", name: "maps", value, checked: true }, words(value))),
    );
    byId("maps").addEventListener("change", () => {
      const which = new FormData(byId<HTMLFormElement>("intake")).get("which");
      byId("maps-choices").hidden = which !== "some";
    });
  }
}

function same(one: File, other: File): boolean {
  return one === other || (one.name === other.name && one.size === other.size && one.lastModified === other.lastModified);
}
