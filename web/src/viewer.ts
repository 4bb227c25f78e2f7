// Everything that needs three.js; loaded when a head is to be shown.

import { headers, request, type Job } from "./api";
import { byId, bytes } from "./dom";
import { facts, filesOf, warningsOf } from "./panel/facts";
import { expressionPanel } from "./panel/expression";
import { lightPanel } from "./panel/light";
import { mapsPanel } from "./panel/maps";
import { type Manifest } from "./viewer/manifest";
import { MapStore } from "./viewer/maps";
import { HeadScene } from "./viewer/scene";

/** Fills the result screen; resolves to what takes it down again. */
export async function openResult(job: Job, erase: () => void, signal: AbortSignal): Promise<() => void> {
  const status = byId("view-status");
  const panel = byId("panel");
  panel.replaceChildren();
  status.textContent = "Loading the head";
  const manifest = (await (await request(`${job.links.files}/manifest.json`, { signal })).json()) as Manifest;
  const files = filesOf(job, manifest, erase);
  panel.append(files.main, ...warningsOf(job, manifest), files.single, facts(job, manifest));

  const canvas = fresh(byId<HTMLCanvasElement>("canvas"));
  let scene: HeadScene;
  try {
    scene = new HeadScene(canvas);
  } catch {
    withoutWebGL(job, manifest);
    return () => undefined;
  }
  try {
    const size = manifest.files.find((file) => file.path === "mesh/head.glb")?.size ?? 0;
    const data = await download(`${job.links.files}/mesh/head.glb`, signal, (have) => {
      status.textContent = `Loading the head, ${bytes(have)}${size ? ` of ${bytes(size)}` : ""}`;
    });
    const store = new MapStore(job.links.files, manifest, scene.textureLimit());
    await scene.load(data, store);
    const light = lightPanel(scene, canvas);
    files.single.before(mapsPanel(scene, store, signal), light, expressionPanel(scene));
    status.textContent = "";
  } catch (error) {
    scene.dispose();
    throw error;
  }
  return () => scene.dispose();
}

/** A canvas keeps the context of the head before; a new one starts clean, without its listeners. */
function fresh(old: HTMLCanvasElement): HTMLCanvasElement {
  const made = old.cloneNode() as HTMLCanvasElement;
  old.replaceWith(made);
  return made;
}

async function download(url: string, signal: AbortSignal, told: (have: number) => void): Promise<ArrayBuffer> {
  const answer = await request(url, { signal, headers: headers() });
  const chunks: BlobPart[] = [];
  let have = 0;
  const reader = answer.body!.getReader();
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    chunks.push(part.value as BlobPart);
    told((have += part.value.length));
  }
  return new Blob(chunks).arrayBuffer();
}

function withoutWebGL(job: Job, manifest: Manifest): void {
  byId("view-status").textContent = "This browser shows no 3D (WebGL 2 is off), so here is the preview.";
  const sheet = manifest.files.find((file) => file.path === "preview/sheet.jpg");
  if (!sheet) return;
  const picture = document.createElement("img");
  picture.alt = "The head from five sides";
  picture.src = `${job.links.files}/${sheet.path}`;
  byId("canvas").replaceWith(picture);
  picture.id = "canvas";
}
