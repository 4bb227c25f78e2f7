// Everything that needs three.js; loaded when a head is to be shown.

import { downloaded, request, type Job } from "./api";
import { byId, bytes, make } from "./dom";
import { artistsPanel } from "./panel/artists";
import { correctPanel, type Again } from "./panel/correct";
import { downloads } from "./panel/downloads";
import { expressionPanel } from "./panel/expression";
import { keeping } from "./panel/keep";
import { lightOfPhoto, lightPanel } from "./panel/light";
import { photosPanel } from "./panel/photos";
import { picturesPanel } from "./panel/pictures";
import { summary } from "./panel/summary";
import type { Problem } from "./problem";
import { Compare } from "./viewer/compare";
import type { Light } from "./viewer/lighting";
import type { Manifest } from "./viewer/manifest";
import { MapStore } from "./viewer/maps";
import { Motion } from "./viewer/motion";
import { byHash, findPhoto } from "./viewer/photo";
import { HeadScene } from "./viewer/scene";

export interface Around {
  /** The photos in this page; none where the job was taken up by its address. */
  photos: readonly File[];
  erase: () => void;
  again: Again;
  gone: (problem: Problem) => void;
}

/** Fills the result screen; resolves to what takes it down again. */
export async function openResult(job: Job, around: Around, signal: AbortSignal): Promise<() => void> {
  const status = byId("view-status");
  const panel = byId("panel");
  panel.replaceChildren();
  byId("view-modes").hidden = true;
  status.textContent = "Loading the head";
  const manifest = (await (await request(`${job.links.files}/manifest.json`, { signal })).json()) as Manifest;
  const keep = keeping(job, around.erase);
  const mine = await byHash(around.photos);
  const photos = photosPanel(manifest, mine);
  const correct = correctPanel(manifest, around.photos.length > 0, around.again, signal);
  panel.append(summary(job, manifest), ...(photos ? [photos] : []), correct, downloads(job, manifest, around.gone, signal), keep);

  const canvas = fresh(byId<HTMLCanvasElement>("canvas"));
  let scene: HeadScene;
  try {
    scene = new HeadScene(canvas);
  } catch {
    keep.before(artistsPanel(job, manifest, null, signal));
    await withoutWebGL(job, manifest, signal);
    return () => undefined;
  }
  try {
    const size = manifest.files.find((file) => file.path === "mesh/head.glb")?.size ?? 0;
    const data = await downloaded(`${job.links.files}/mesh/head.glb`, signal, (have) => {
      status.textContent = `Loading the head, ${bytes(have)}${size ? ` of ${bytes(size)}` : ""}`;
    });
    const store = new MapStore(job.links.files, manifest, scene.textureLimit());
    await scene.load(await data.arrayBuffer(), store);
    const motion = new Motion(scene);
    const parts = [expressionPanel(scene, motion), lightPanel(scene, canvas, manifest.fit), picturesPanel(scene, signal)];
    keep.before(...parts, artistsPanel(job, manifest, { scene, store }, signal));
    status.textContent = "";
    const photo = around.photos.length > 1 ? mine.get(manifest.input?.sha256 ?? "") : around.photos[0];
    const compare = await comparison(scene, job, manifest, photo, signal);
    modes(scene, compare, lightOfPhoto(manifest.fit));
    return () => {
      motion.dispose();
      compare?.dispose();
      scene.dispose();
    };
  } catch (error) {
    scene.dispose();
    throw error;
  }
}

/** The head beside the photo; null where there is no photo to be had, which spoils nothing else. */
async function comparison(
  scene: HeadScene,
  job: Job,
  manifest: Manifest,
  local: File | undefined,
  signal: AbortSignal,
): Promise<Compare | null> {
  if (!manifest.camera) return null;
  const box = scene.boxInPhoto(manifest.camera);
  const photo = await findPhoto(local, job.links.files, manifest, signal).catch(() => null);
  signal.throwIfAborted();
  return photo && new Compare(scene, manifest.camera, photo, box);
}

/** What dragging on the view does: turn the head, move the light, wipe between photo and head in the photo's light. */
function modes(scene: HeadScene, compare: Compare | null, photoLight: Partial<Light> | null): void {
  const choices = [...document.querySelectorAll<HTMLInputElement>("input[name=drag]")];
  const [head, , photo] = choices;
  let before: Light | null = null;
  const apply = () => {
    scene.controls.enableRotate = !choices.some((choice) => choice.checked && choice.value === "light");
    if (!compare) return;
    if (photo!.checked && photoLight && !before) {
      before = { ...scene.light };
      scene.moveLight(photoLight);
    } else if (!photo!.checked && before) {
      scene.moveLight(before);
      before = null;
    }
    compare.show(photo!.checked);
  };
  for (const choice of choices) choice.onchange = apply;
  head!.checked = true;
  photo!.parentElement!.hidden = !compare;
  byId("inset").onclick = () => {
    photo!.checked = true;
    apply();
    byId("wipe").focus();
  };
  byId("view-modes").hidden = false;
  apply();
}

/** A canvas keeps the context of the head before; a new one starts clean, without its listeners. */
function fresh(old: HTMLElement): HTMLCanvasElement {
  const label = "The head in three dimensions";
  const made = make("canvas", { id: "canvas", tabindex: 0, role: "application", "aria-label": label, "aria-describedby": "canvas-keys" });
  old.replaceWith(made);
  return made;
}

async function withoutWebGL(job: Job, manifest: Manifest, signal: AbortSignal): Promise<void> {
  byId("view-status").textContent = "This browser shows no 3D (WebGL 2 is off), so here is the preview.";
  const sheet = manifest.files.find((file) => file.path === "preview/sheet.jpg");
  if (!sheet) return;
  const data = await downloaded(`${job.links.files}/${sheet.path}`, signal, () => undefined);
  const picture = make("img", { id: "canvas", alt: "The head from five sides", src: URL.createObjectURL(data) });
  byId("canvas").replaceWith(picture);
}
