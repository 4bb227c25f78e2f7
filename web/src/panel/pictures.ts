// Pictures and films of the head as it is shown, and what is behind it.

import { byId, choice, make } from "../dom";
import type { HeadScene } from "../viewer/scene";
import { save } from "./downloads";
import { group } from "./group";

const TURN_S = 10;

/** Degrees between two frames of a film at most: a slow machine takes longer for it. */
const LARGEST_STEP = 6;

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
    const made = document.createElement("canvas");
    scene.capture((canvas) => copy(canvas, made));
    made.toBlob((blob) => blob && save(URL.createObjectURL(blob), "head.png"), "image/png");
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
      film.textContent = "Filming";
      spin(false);
      void recorded(scene, type, signal)
        .then((blob) => save(URL.createObjectURL(blob), `head.${type.split("/")[1]}`))
        .catch((error: Error) => signal.aborted || (byId("view-status").textContent = `The film could not be saved: ${error.message}`))
        .finally(() => {
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

/** Copies what the canvas shows, over the page's gradient where a picture is to have it. */
function copy(from: HTMLCanvasElement, to: HTMLCanvasElement): void {
  const { width, height } = from;
  if (to.width !== width) to.width = width;
  if (to.height !== height) to.height = height;
  const brush = to.getContext("2d")!;
  brush.clearRect(0, 0, width, height);
  if (document.querySelector<HTMLInputElement>("input[name=background]:checked")?.value === "") {
    const style = getComputedStyle(document.documentElement);
    const fill = brush.createRadialGradient(width / 2, 0.42 * height, 0, width / 2, 0.42 * height, 0.6 * Math.hypot(width, height));
    for (const [at, name] of ["--view-centre", "--view-rim"].entries()) fill.addColorStop(at, style.getPropertyValue(name).trim());
    brush.fillStyle = fill;
    brush.fillRect(0, 0, width, height);
  }
  brush.drawImage(from, 0, 0);
}

/** Films copies of what is drawn: of a WebGL canvas itself some browsers film nothing, and none what lies behind it. */
function recorded(scene: HeadScene, mimeType: string, signal: AbortSignal): Promise<Blob> {
  const film = document.createElement("canvas");
  scene.capture((canvas) => copy(canvas, film));
  const stream = film.captureStream(30);
  const track = stream.getVideoTracks()[0] as CanvasCaptureMediaStreamTrack;
  return new Promise<Blob>((resolve, reject) => {
    const recorder = new MediaRecorder(stream, { mimeType, videoBitsPerSecond: 12_000_000 });
    const parts: Blob[] = [];
    recorder.ondataavailable = (event) => parts.push(event.data);
    recorder.onstop = () => {
      const made = new Blob(parts, { type: mimeType });
      if (made.size && !signal.aborted) resolve(made);
      else reject(signal.reason ?? new Error("this browser recorded nothing"));
    };
    recorder.onerror = () => reject(new Error("it could not be recorded"));
    recorder.start(1000); // in pieces: an encoder that lags would give nothing at the end
    signal.addEventListener("abort", () => recorder.state === "recording" && recorder.stop(), { once: true });
    let [turned, last] = [0, performance.now()];
    scene.drawn = (canvas) => {
      if (recorder.state !== "recording") return;
      copy(canvas, film);
      track.requestFrame?.(); // where it is left out, each change is a frame
      if (turned >= 360) return recorder.stop();
      const step = Math.min((360 / TURN_S) * ((performance.now() - last) / 1000), LARGEST_STEP, 360 - turned);
      [turned, last] = [turned + step, performance.now()];
      requestAnimationFrame(() => scene.turn(step, 0));
    };
    scene.draw();
  }).finally(() => {
    scene.drawn = () => undefined;
    track.stop();
  });
}

function button(title: string, pressed: () => void): HTMLButtonElement {
  const made = make("button", { type: "button", class: "small" }, title);
  made.addEventListener("click", pressed);
  return made;
}
