// The photo and the head in the same place of the view, with a slider that wipes from one to the other.

import { byId, make } from "../dom";
import { wipe } from "../wipe";
import type { PhotoCamera } from "./manifest";
import type { SourcePhoto } from "./photo";
import type { PixelBox } from "./photo_camera";
import type { HeadScene } from "./scene";

/** Room about the head, as a share of its height. */
const ROOM = 0.12;

/** Width and height of the small photo beside the head. */
const INSET = [84, 105] as const;

export class Compare {
  private readonly view = byId("view");
  private readonly layer = byId("photo-layer");
  private readonly watcher = new ResizeObserver(() => this.place());
  private readonly slider = wipe(this.view);
  private on = false;

  constructor(
    private readonly scene: HeadScene,
    private readonly camera: PhotoCamera,
    private readonly photo: SourcePhoto,
    private readonly head: PixelBox,
  ) {
    photo.picture.id = "compare-photo";
    if (photo.picture instanceof HTMLImageElement) photo.picture.alt = "";
    else photo.picture.setAttribute("aria-hidden", "true");
    this.layer.replaceChildren(photo.picture);
    byId("inset").replaceChildren(this.thumbnail());
    this.watcher.observe(this.view);
  }

  show(on: boolean): void {
    if (on && !this.on) this.slider.set(50);
    this.on = on;
    this.layer.hidden = byId("wipe-tools").hidden = !on;
    byId("reset-view").hidden = byId("inset").hidden = byId("canvas-keys").hidden = on;
    byId("wipe-keys").hidden = !on;
    byId("canvas").tabIndex = on ? -1 : 0;
    this.view.classList.toggle("comparing", on);
    if (on) this.place();
    else this.scene.lookAsPhoto(this.camera, null);
  }

  dispose(): void {
    this.watcher.disconnect();
    this.show(false);
    byId("inset").hidden = true;
    this.layer.replaceChildren();
  }

  /** The head's part of the photo, small. */
  private thumbnail(): HTMLCanvasElement {
    const made = make("canvas", { width: 2 * INSET[0], height: 2 * INSET[1] });
    const [left, top, right, bottom] = within(this.head, this.photo.box, INSET[0] / INSET[1]);
    const [x, y, end] = this.photo.box;
    const { picture } = this.photo;
    const scale = (picture instanceof HTMLImageElement ? picture.naturalWidth : picture.width) / (end - x);
    const part = [left - x, top - y, right - left, bottom - top].map((side) => side * scale) as PixelBox;
    made.getContext("2d")!.drawImage(picture, ...part, 0, 0, made.width, made.height);
    return made;
  }

  private place(): void {
    if (!this.on) return;
    const { clientWidth: width, clientHeight: height } = this.view;
    const window = around(this.head, width / height);
    const scale = width / (window[2] - window[0]);
    const { style } = this.photo.picture;
    style.left = `${(this.photo.box[0] - window[0]) * scale}px`;
    style.top = `${(this.photo.box[1] - window[1]) * scale}px`;
    style.width = `${(this.photo.box[2] - this.photo.box[0]) * scale}px`;
    style.height = `${(this.photo.box[3] - this.photo.box[1]) * scale}px`;
    this.scene.lookAsPhoto(this.camera, window);
  }
}

/** Box of that width over height about another one, with some room. */
function around(box: PixelBox, aspect: number): PixelBox {
  const [width, height] = [box[2] - box[0], box[3] - box[1]];
  const high = Math.max(height, width / aspect) * (1 + 2 * ROOM);
  const [x, y] = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
  return [x - (high * aspect) / 2, y - high / 2, x + (high * aspect) / 2, y + high / 2];
}

/** The largest box of that width over height in the middle of what two boxes share. */
function within(one: PixelBox, other: PixelBox, aspect: number): PixelBox {
  const [left, top] = [Math.max(one[0], other[0]), Math.max(one[1], other[1])];
  const [right, bottom] = [Math.min(one[2], other[2]), Math.min(one[3], other[3])];
  const high = Math.min(bottom - top, (right - left) / aspect);
  const [x, y] = [(left + right - high * aspect) / 2, (top + bottom - high) / 2];
  return [x, y, x + high * aspect, y + high];
}
