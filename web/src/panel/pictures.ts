// Pictures and films of the head as it is shown, and what is behind it.

import { byId, choice, make } from "../dom";
import type { HeadScene } from "../viewer/scene";
import { save } from "./downloads";
import { group } from "./group";

const TURN_S = 10;

/** Colours behind the head; "" is the page's own gradient, "none" lets a saved picture be transparent there. */
const BACKGROUNDS: [title: string, colour: string][] = [
  ["Studio", ""],
  ["White", "#ffffff"],
  ["Grey", "#777777"],
  ["Black", "#000000"],
  ["None", "none"],
];

export function picturesPanel(scene: HeadScene, signal: AbortSignal): HTMLElement {
  const panel = group("Pictures", false);
  panel.element.id = "pictures";
  const picture = button("Save picture", () => {
    void scene.picture(behind()).then((blob) => save(URL.createObjectURL(blob), "head.png"));
  });
  const table = button("Turntable", () => spin(!scene.spinning));
  const spin = (on: boolean) => {
    scene.spin(on ? 360 / TURN_S : 0);
    table.setAttribute("aria-pressed", String(on));
  };
  spin(false);
  const row = make("div", { class: "row" }, picture, table);
  const type = ["video/mp4", "video/webm"].find((one) => globalThis.MediaRecorder?.isTypeSupported(one));
  if (type) {
    const film = button("Save turntable", () => {
      film.disabled = true;
      film.textContent = `Filming ${TURN_S} s`;
      spin(true);
      void recorded(byId<HTMLCanvasElement>("canvas"), type, signal)
        .then((blob) => save(URL.createObjectURL(blob), `head.${type.split("/")[1]}`))
        .catch((error: Error) => signal.aborted || (byId("view-status").textContent = `The film could not be saved: ${error.message}`))
        .finally(() => {
          spin(false);
          film.disabled = false;
          film.textContent = "Save turntable";
        });
    });
    row.append(film);
  }
  const chips = BACKGROUNDS.map(([title, colour]) => {
    const chip = choice("chip", { name: "background", value: colour, checked: !colour }, title);
    chip.addEventListener("change", () => {
      scene.background(colour.startsWith("#") ? colour : null);
      byId("view").classList.toggle("checkered", colour === "none");
    });
    return chip;
  });
  panel.body.append(row, make("div", { class: "chips", role: "radiogroup", "aria-label": "Background" }, ...chips));
  return panel.element;
}

/** Centre and rim of the page's gradient where a picture is to have it. */
function behind(): [string, string] | null {
  if (document.querySelector<HTMLInputElement>("input[name=background]:checked")?.value !== "") return null;
  const style = getComputedStyle(document.documentElement);
  return [style.getPropertyValue("--view-centre"), style.getPropertyValue("--view-rim")];
}

function recorded(canvas: HTMLCanvasElement, mimeType: string, signal: AbortSignal): Promise<Blob> {
  return new Promise((resolve, reject) => {
    const recorder = new MediaRecorder(canvas.captureStream(30), { mimeType, videoBitsPerSecond: 12_000_000 });
    const parts: Blob[] = [];
    recorder.ondataavailable = (event) => parts.push(event.data);
    recorder.onstop = () => {
      const film = new Blob(parts, { type: mimeType });
      if (film.size && !signal.aborted) resolve(film);
      else reject(signal.reason ?? new Error("this browser recorded nothing"));
    };
    recorder.onerror = () => reject(new Error("the film could not be recorded"));
    recorder.start(1000); // in pieces: an encoder that lags would give nothing at the end
    const timer = window.setTimeout(() => recorder.stop(), 1000 * TURN_S);
    signal.addEventListener("abort", () => (window.clearTimeout(timer), recorder.stop()), { once: true });
  });
}

function button(title: string, pressed: () => void): HTMLButtonElement {
  const made = make("button", { type: "button", class: "small" }, title);
  made.addEventListener("click", pressed);
  return made;
}
