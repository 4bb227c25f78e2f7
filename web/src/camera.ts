// The guide at the camera: one picture from the front, then one with the head turned to either side.

import { byId } from "./dom";

const STEPS: [title: string, text: string][] = [
  ["Look straight ahead", "At the camera, with a relaxed face."],
  ["Turn left", "Your head, about half way to your left shoulder."],
  ["Turn right", "Back and to the other side, as far."],
];

/** Seconds from a step's words to its picture: to hear them, to turn, to hold still. */
const COUNT = 4;
const SECOND_MS = 1000;

/** Whether this browser lets the page see a camera; over plain HTTP from another machine none does. */
export async function hasCamera(): Promise<boolean> {
  const devices = await navigator.mediaDevices?.enumerateDevices().catch(() => []);
  return devices?.some((device) => device.kind === "videoinput") ?? false;
}

/**
 * Leads through the steps; resolves to the pictures, fewer where the guide was closed before its end.
 *
 * Rejects with the browser's error where the camera may not be used.
 */
export async function guided(): Promise<File[]> {
  const dialog = byId<HTMLDialogElement>("guide");
  const video = byId<HTMLVideoElement>("guide-video");
  const size = { width: { ideal: 1920 }, height: { ideal: 1440 } };
  const stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "user", ...size } });
  const taken: File[] = [];
  try {
    video.srcObject = stream;
    await video.play();
    say(0, `${STEPS[0]![1]} Three pictures are taken, ${COUNT} seconds after each hint.`, "");
    byId("guide-start").hidden = false;
    dialog.showModal();
    byId("guide-close").onclick = () => dialog.close();
    const closed = new Promise<false>((resolve) => (dialog.onclose = () => resolve(false)));
    const started = new Promise<true>((resolve) => (byId("guide-start").onclick = () => resolve(true)));
    if (!(await Promise.race([started, closed]))) return taken;
    byId("guide-start").hidden = true;
    for (const [step, [title, text]] of STEPS.entries()) {
      for (let left = COUNT; left > 0; left--) {
        say(step, text, String(left));
        const second = new Promise<true>((resolve) => window.setTimeout(() => resolve(true), SECOND_MS));
        if (!(await Promise.race([second, closed]))) return taken;
      }
      taken.push(await frame(video, `${title.toLowerCase().replaceAll(" ", "-")}.jpg`));
    }
    return taken;
  } finally {
    for (const track of stream.getTracks()) track.stop();
    video.srcObject = null;
    dialog.close();
  }
}

function say(step: number, text: string, count: string): void {
  byId("guide-title").textContent = `${step + 1} of ${STEPS.length}: ${STEPS[step]![0]}`;
  byId("guide-count").textContent = count;
  if (byId("guide-text").textContent !== text) byId("guide-text").textContent = text;
}

function frame(video: HTMLVideoElement, name: string): Promise<File> {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
  canvas.getContext("2d")!.drawImage(video, 0, 0);
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob ? resolve(new File([blob], name, { type: "image/jpeg" })) : reject(new Error("no picture"))), "image/jpeg", 0.95),
  );
}
