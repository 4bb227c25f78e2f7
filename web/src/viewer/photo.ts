// The photo that the head was made from: the one that was handed in, or the panel of it in preview/overlay.jpg.

import { request } from "../api";
import type { Manifest } from "./manifest";
import type { PixelBox } from "./photo_camera";

/** Layout of preview/overlay.jpg: service/archive/preview/overlay.py, three panels side by side, the first is the photo. */
const MARGIN = 12;
const CAPTION = 34;
const AROUND = 0.18;

export interface SourcePhoto {
  picture: HTMLImageElement | HTMLCanvasElement;
  /** Part of the photo that the picture shows, in pixels of the photo. */
  box: PixelBox;
}

/**
 * The photo to compare with, or null where there is none.
 *
 * `head` is the box of the fitted head in the photo. The server erases the photo itself; its preview keeps a part.
 */
export async function findPhoto(
  local: string,
  files: string,
  manifest: Manifest,
  head: PixelBox,
  signal: AbortSignal,
): Promise<SourcePhoto | null> {
  const { camera } = manifest;
  if (!camera || !manifest.input) return null;
  if (local) {
    const picture = await loaded(local).catch(() => null); // a format that this browser does not show
    const aspect = picture ? picture.naturalWidth / picture.naturalHeight : 0;
    if (picture && Math.abs(aspect / (camera.width / camera.height) - 1) < 0.01)
      return { picture, box: [0, 0, camera.width, camera.height] };
  }
  if (!manifest.files.some((file) => file.path === "preview/overlay.jpg")) return null;
  const data = await (await request(`${files}/preview/overlay.jpg`, { signal })).blob();
  const address = URL.createObjectURL(data);
  return loaded(address)
    .then((sheet) => panel(sheet, cropBox(manifest, head)))
    .finally(() => URL.revokeObjectURL(address));
}

/** The crop that the overlay shows: head and detected face with some room, within the photo. */
function cropBox(manifest: Manifest, head: PixelBox): PixelBox {
  const face = manifest.input!.face_box;
  const { width, height } = manifest.camera!;
  const reach = [2 * (face[2] - face[0]), 2 * (face[3] - face[1])];
  const low = [0, 1].map((axis) => Math.max(Math.min(head[axis]!, face[axis]!), face[axis]! - reach[axis]!));
  const high = [0, 1].map((axis) => Math.min(Math.max(head[axis + 2]!, face[axis + 2]!), face[axis + 2]! + reach[axis]!));
  const room = AROUND * Math.max(high[0]! - low[0]!, high[1]! - low[1]!);
  const within = (value: number, most: number) => Math.min(Math.max(value, 0), most);
  return [
    Math.floor(within(low[0]! - room, width)),
    Math.floor(within(low[1]! - room, height)),
    Math.ceil(within(high[0]! + room, width)),
    Math.ceil(within(high[1]! + room, height)),
  ];
}

/** The first panel of the overlay; null where it is not laid out as this page knows it. */
function panel(sheet: HTMLImageElement, box: PixelBox): SourcePhoto | null {
  const width = Math.round((sheet.naturalWidth - 4 * MARGIN) / 3);
  const height = sheet.naturalHeight - MARGIN - CAPTION;
  const zoom = [width / (box[2] - box[0]), height / (box[3] - box[1])];
  if (!(Math.abs(zoom[0]! / zoom[1]! - 1) < 0.02)) return null;
  const picture = document.createElement("canvas");
  picture.width = width;
  picture.height = height;
  picture.getContext("2d")!.drawImage(sheet, MARGIN, MARGIN, width, height, 0, 0, width, height);
  return { picture, box };
}

async function loaded(address: string): Promise<HTMLImageElement> {
  const image = new Image();
  image.src = address;
  await image.decode();
  return image;
}
