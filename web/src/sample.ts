// The sample photo that comes with the page, for who has none at hand.

import { request } from "./api";

const PHOTO = "sample.jpg";

export async function samplePhoto(signal: AbortSignal): Promise<File> {
  const photo = await (await request(PHOTO, { signal })).blob();
  return new File([photo], "sample.jpg", { type: "image/jpeg" });
}
