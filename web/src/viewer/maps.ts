// Maps of the archive as textures, fetched when they are first looked at and made smaller while they are decoded.

import {
  LinearFilter,
  LinearMipmapLinearFilter,
  NearestFilter,
  NoColorSpace,
  SRGBColorSpace,
  Texture,
  Vector2,
} from "three";
import { request } from "../api";
import type { Manifest, MapEntry } from "./manifest";

/** Order of the switches. */
const ROLES = [
  "texture",
  "diffuse_albedo",
  "specular_albedo",
  "diffuse_normal",
  "specular_normal",
  "displacement",
  "confidence",
  "shape_normal",
];

interface Picture {
  bitmap: ImageBitmap;
  coding: Vector2;
}

export class MapStore {
  readonly maps: MapEntry[];
  private readonly pictures = new Map<string, Promise<Picture>>();
  private readonly textures = new Map<string, Texture>();

  constructor(
    private readonly files: string,
    manifest: Manifest,
    private readonly limit: number,
  ) {
    const place = (map: MapEntry) => (ROLES.indexOf(map.role) + ROLES.length + 1) % (ROLES.length + 1);
    this.maps = [...manifest.maps].sort((a, b) => place(a) - place(b));
  }

  entry(role: string): MapEntry | undefined {
    return this.maps.find((map) => map.role === role);
  }

  /** Whether the map is here already, or small enough to fetch without asking. */
  light(role: string): boolean {
    return this.pictures.has(role) || (this.entry(role)?.size ?? Infinity) < 6e6;
  }

  /** The picture inside the GLB, so that the first view costs no second download. */
  seed(role: string, bitmap: ImageBitmap): void {
    this.pictures.set(role, Promise.resolve({ bitmap, coding: new Vector2(0, 1) }));
  }

  /** Texture whose codes come out as colours of that meaning: `srgb` decodes, `data` leaves them alone. */
  async texture(role: string, meaning: "srgb" | "data", signal: AbortSignal): Promise<Texture> {
    const { bitmap } = await this.picture(role, signal);
    const key = `${role} ${meaning}`;
    const known = this.textures.get(key);
    if (known) return known;
    const texture = new Texture(bitmap);
    texture.flipY = false; // glTF's v grows downwards
    texture.colorSpace = meaning === "srgb" ? SRGBColorSpace : NoColorSpace;
    const whole = role === "confidence"; // its codes are classes, and between two of them lies a third
    texture.minFilter = whole ? NearestFilter : LinearMipmapLinearFilter;
    texture.magFilter = whole ? NearestFilter : LinearFilter;
    texture.generateMipmaps = !whole;
    texture.anisotropy = 8;
    texture.needsUpdate = true;
    this.textures.set(key, texture);
    return texture;
  }

  /** (zero, scale) of the codes as shares of the largest code: value = (code - zero) / scale. */
  async coding(role: string, signal: AbortSignal): Promise<Vector2> {
    return (await this.picture(role, signal)).coding;
  }

  dispose(): void {
    for (const texture of this.textures.values()) texture.dispose();
    for (const picture of this.pictures.values()) void picture.then((p) => p.bitmap.close()).catch(() => undefined);
  }

  private picture(role: string, signal: AbortSignal): Promise<Picture> {
    let picture = this.pictures.get(role);
    if (!picture) {
      picture = this.fetch(role, signal);
      this.pictures.set(role, picture);
      picture.catch(() => this.pictures.delete(role)); // so that the next look tries again
    }
    return picture;
  }

  private async fetch(role: string, signal: AbortSignal): Promise<Picture> {
    const map = this.entry(role);
    if (!map) throw new Error(`the archive has no map ${role}`);
    const blob = await (await request(`${this.files}/${map.path}`, { signal })).blob();
    const share = Math.min(1, this.limit / Math.max(map.width, map.height));
    const bitmap = await createImageBitmap(blob, {
      premultiplyAlpha: "none",
      colorSpaceConversion: "none",
      resizeWidth: Math.round(map.width * share),
      resizeHeight: Math.round(map.height * share),
      resizeQuality: role === "confidence" ? "pixelated" : "high",
    });
    const largest = 2 ** map.bits - 1;
    return { bitmap, coding: new Vector2(map.coding.zero / largest, map.coding.scale / largest) };
  }
}
