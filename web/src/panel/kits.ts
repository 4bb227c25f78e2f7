// What one may want to download.

import type { Manifest } from "../viewer/manifest";

export interface Kit {
  id: string;
  title: string;
  about: string;
  /** Name of what is saved. */
  name: string;
  /** A file of the archive, the archive, or a kit that the server makes, as `avatarme export` does. */
  from: "file" | "archive" | "export";
  size?: number;
}

export const HEAD = "mesh/head.glb";
const TOOLS = {
  blender: ["Blender", "Scene with skeleton and shape keys"],
  unreal: ["Unreal", "Levels of detail, packed textures"],
  unity: ["Unity", "Levels of detail, HDRP masks"],
  maya: ["Maya", "USD, levels of detail, Arnold maps"],
} as const;

/** Names are those that the server gives, which a browser prefers. */
export function kitsOf(manifest: Manifest, job: string): Kit[] {
  const name = `avatar-${job.slice(0, 8)}`;
  const glb = manifest.files.find((file) => file.path === HEAD);
  const all = manifest.files.reduce((sum, file) => sum + file.size, 0);
  const widest = manifest.maps.reduce((best, map) => (map.width > best.width ? map : best), { width: 0, height: 0 });
  const maps = widest.width ? `; maps ${widest.width}\u00a0×\u00a0${widest.height}` : "";
  const kits: Kit[] = [];
  if (glb) {
    kits.push({ id: "glb", title: "GLB only", about: "One file for web pages, games and viewers", name: "head.glb", from: "file", size: glb.size });
    for (const [id, [title, about]] of Object.entries(TOOLS))
      kits.push({ id, title: `For ${title}`, about: `${about}${maps}`, name: `${name}-${id}.zip`, from: "export" });
  }
  kits.push({ id: "all", title: "All files", about: "Also OBJ, USD, previews, measurements", name: `${name}.zip`, from: "archive", size: all });
  return kits;
}
