// What one may want to download, as lists of files of the archive.

import type { Manifest } from "../viewer/manifest";

export interface Kit {
  id: string;
  title: string;
  about: string;
  /** Name of what is saved. */
  name: string;
  /** One file as it is, the whole archive, or several files as a zip that this page makes. */
  from: "file" | "archive" | "zip";
  paths: string[];
  size: number;
  readme?: string;
}

const HEAD = "mesh/head.glb";
const SURFACE = ["diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "displacement"];

export function kitsOf(manifest: Manifest): Kit[] {
  const sizes = new Map(manifest.files.map((file) => [file.path, file.size]));
  const total = (paths: string[]) => paths.reduce((sum, path) => sum + (sizes.get(path) ?? 0), 0);
  const roles = manifest.maps.some((map) => SURFACE.includes(map.role)) ? SURFACE : ["texture"];
  const maps = roles.flatMap((role) => manifest.maps.filter((map) => map.role === role).map((map) => map.path));
  const all = [...sizes.keys()];
  const wanted = [HEAD, ...maps, "LICENSES.md"].filter((path) => sizes.has(path));
  const kits: Kit[] = [];
  if (sizes.has(HEAD)) {
    const about = "One file for web pages, games and viewers";
    kits.push({ id: "glb", title: "GLB only", about, name: "head.glb", from: "file", paths: [HEAD], size: total([HEAD]) });
    for (const [id, title, readme] of [
      ["blender", "For Blender", blender(manifest)],
      ["unreal", "For Unreal", unreal()],
    ] as const)
      kits.push({
        id,
        title,
        about: maps.length ? "GLB, full-size maps, how to import them" : "GLB, how to import it",
        name: `head-for-${id}.zip`,
        from: "zip",
        paths: wanted,
        size: total(wanted),
        readme,
      });
  }
  kits.push({ id: "all", title: "All files", about: "Also OBJ, USD, previews, measurements", name: "avatar.zip", from: "archive", paths: all, size: total(all) });
  return kits;
}

function blender(manifest: Manifest): string {
  const relief = manifest.displacement;
  const metres = relief ? (65535 * relief.scale_mm) / 1000 : 0;
  return lines(
    "This head in Blender",
    "",
    "1. File > Import > glTF 2.0, choose mesh/head.glb. It has 52 shape keys and textures of at most 2048 pixels.",
    "2. For the full-size maps open the Shading workspace and choose them in the image nodes of the skin:",
    "   Base Color            maps/diffuse_albedo.png    Color Space sRGB",
    "   Normal (Normal Map)   maps/specular_normal.png   Color Space Non-Color, tangent space",
    "   Specular IOR Level    maps/specular_albedo.png   Non-Color, times 0.5 (Math node): 0.5 is F0 = 0.04",
    ...(relief
      ? [`   Displacement          maps/displacement.png      Non-Color, Midlevel 0.5, Scale ${metres.toFixed(5)} (metres)`]
      : []),
    "   maps/diffuse_normal.png is for a second, diffuse lobe: the light inside the skin.",
    "3. Subsurface scattering on, with a scale of 1 mm to 3 mm.",
    "",
    "A map that is not in this zip was not made.",
  );
}

function unreal(): string {
  return lines(
    "This head in Unreal Engine 5",
    "",
    "1. Drag mesh/head.glb into the Content Browser. The Interchange importer takes metres to centimetres and makes a",
    "   skeletal mesh with 52 morph targets (leave Import Morph Targets on).",
    "2. Import the maps and set in each texture:",
    "   maps/diffuse_albedo.png    sRGB on; to Base Color",
    "   maps/specular_albedo.png   sRGB off; to Specular, times 0.5: Unreal's 0.5 is F0 = 0.04",
    "   maps/specular_normal.png   Compression Normalmap, Flip Green Channel on (the maps have +Y up); to Normal",
    "   maps/displacement.png      sRGB off, 16 bits; for Nanite displacement or a sculpting tool",
    "3. Shading Model Subsurface Profile for the skin.",
    "",
    "A map that is not in this zip was not made.",
  );
}

function lines(...text: string[]): string {
  return `${text.join("\r\n")}\r\n`;
}
