// mesh/head.glb as three.js objects.

import { Group, Mesh, MeshStandardMaterial, Texture } from "three";
import { GLTFLoader, type GLTFParser } from "three/addons/loaders/GLTFLoader.js";

export type HeadPart = Mesh<Mesh["geometry"], MeshStandardMaterial>;

export interface LoadedHead {
  group: Group;
  meshes: HeadPart[];
  /** Pictures inside the file, by the name of their texture. */
  pictures: Map<string, ImageBitmap>;
  /** Weights of the photo's expression by name. */
  expression: Record<string, number>;
}

export async function loadHead(data: ArrayBuffer): Promise<LoadedHead> {
  const loader = new GLTFLoader();
  const pictures = new Map<string, ImageBitmap>();
  // The loader's own way fetches a blob: address, which the content security policy does not allow.
  loader.register((parser) => ({ name: "pictures", loadTexture: (index: number) => picture(parser, index, pictures) }));
  const gltf = await loader.parseAsync(data, "");
  const meshes: HeadPart[] = [];
  let expression: Record<string, number> = {};
  gltf.scene.traverse((object) => {
    if (object instanceof Mesh && object.material instanceof MeshStandardMaterial) meshes.push(object as HeadPart);
    if (object.userData.expressionWeights) expression = object.userData.expressionWeights;
  });
  return { group: gltf.scene, meshes, pictures, expression };
}

/** Whether the maps of the archive lie on this material; the file says so. */
export function onChart(material: MeshStandardMaterial): boolean {
  return material.userData.chart === true;
}

/** The file's material as this page draws it. */
export function drawable(material: MeshStandardMaterial): MeshStandardMaterial {
  // The cards' edges, which a cut by alpha alone leaves jagged.
  material.alphaToCoverage = material.alphaTest > 0;
  material.depthWrite = !material.transparent;
  return material;
}

async function picture(parser: GLTFParser, index: number, pictures: Map<string, ImageBitmap>): Promise<Texture> {
  const definition = parser.json.textures[index];
  const image = parser.json.images[definition.source];
  const bytes = (await parser.getDependency("bufferView", image.bufferView)) as ArrayBuffer;
  const bitmap = await createImageBitmap(new Blob([bytes], { type: image.mimeType }), {
    premultiplyAlpha: "none",
    colorSpaceConversion: "none",
  });
  pictures.set(definition.name ?? image.name ?? "texture", bitmap);
  const texture = new Texture(bitmap);
  texture.flipY = false; // glTF's v grows downwards
  texture.anisotropy = 8;
  texture.needsUpdate = true;
  return texture;
}
