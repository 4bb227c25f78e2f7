// mesh/head.glb as three.js objects.

import { Group, Mesh, MeshStandardMaterial, Texture } from "three";
import { GLTFLoader, type GLTFParser } from "three/addons/loaders/GLTFLoader.js";

export interface LoadedHead {
  group: Group;
  meshes: Mesh[];
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
  const meshes: Mesh[] = [];
  let expression: Record<string, number> = {};
  gltf.scene.traverse((object) => {
    if (object instanceof Mesh && object.material instanceof MeshStandardMaterial) meshes.push(object);
    if (object.userData.expressionWeights) expression = object.userData.expressionWeights;
  });
  return { group: gltf.scene, meshes, pictures, expression };
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
  return new Texture(bitmap);
}
