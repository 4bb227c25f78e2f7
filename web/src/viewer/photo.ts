// The photo that the head was made from: the one that was handed in, or the panel of it in preview/overlay.jpg.

import { request } from "../api";
import { hex } from "../dom";
import type { Manifest } from "./manifest";
import type { PixelBox } from "./photo_camera";

export interface SourcePhoto {
  picture: HTMLImageElement | HTMLCanvasElement;
  /** Part of the photo that the picture shows, in pixels of the photo. */
  box: PixelBox;
}

/** Files by the hash that the manifest has of them; none over plain HTTP from another machine, where nothing is hashed. */
export async function byHash(files: readonly File[]): Promise<Map<string, File>> {
  if (!crypto.subtle) return new Map();
  const pairs = files.map(async (file): Promise<[string, File]> => {
    return [hex(new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()))), file];
  });
  return new Map(await Promise.all(pairs));
}

/** The photo to compare with, or null where there is none. The server erases the photo itself; its preview keeps a part. */
export async function findPhoto(
  local: File | undefined,
  files: string,
  manifest: Manifest,
  signal: AbortSignal,
): Promise<SourcePhoto | null> {
  const { camera, overlay } = manifest;
  if (!camera) return null;
  if (local) {
    const picture = await shown(local).catch(() => null); // a format that this browser does not show
    const aspect = picture ? picture.naturalWidth / picture.naturalHeight : 0;
    if (picture && Math.abs(aspect / (camera.width / camera.height) - 1) < 0.01)
      return { picture, box: [0, 0, camera.width, camera.height] };
  }
  if (!overlay) return null;
  const data = await (await request(`${files}/preview/overlay.jpg`, { signal })).blob();
  return panel(await shown(data), overlay.panel, overlay.crop);
}

/** The panel of the overlay that has the photo. */
function panel(sheet: HTMLImageElement, [left, top, right, bottom]: PixelBox, crop: PixelBox): SourcePhoto {
  const picture = document.createElement("canvas");
  picture.width = right - left;
  picture.height = bottom - top;
  picture.getContext("2d")!.drawImage(sheet, left, top, picture.width, picture.height, 0, 0, picture.width, picture.height);
  return { picture, box: crop };
}

async function shown(data: Blob): Promise<HTMLImageElement> {
  const image = new Image();
  image.src = URL.createObjectURL(data);
  return image.decode().then(() => image).finally(() => URL.revokeObjectURL(image.src));
}
