// The camera that took the photo, as the manifest tells it, for three.js.

import { Matrix4, Vector3, type Mesh, type PerspectiveCamera } from "three";
import type { PhotoCamera } from "./manifest";

/** left, top, right, bottom in pixels of the upright photo. */
export type PixelBox = [number, number, number, number];

const NEAR_M = 0.05;
const FAR_M = 20;

/** Makes `target` see what `source` saw in `window`. Photos have x right, y down, z forward; three.js y up, z back. */
export function lookThrough(target: PerspectiveCamera, source: PhotoCamera, window: PixelBox): void {
  const [x, y, z] = source.rotation.map((row) => new Vector3(...row)) as [Vector3, Vector3, Vector3];
  const [tx, ty, tz] = source.translation;
  target.position.set(0, 0, 0).addScaledVector(x, -tx).addScaledVector(y, -ty).addScaledVector(z, -tz);
  target.quaternion.setFromRotationMatrix(new Matrix4().makeBasis(x, y.clone().negate(), z.clone().negate()));
  target.updateMatrixWorld();
  const [cx, cy] = source.principal_point;
  const [left, top, right, bottom] = window;
  const scale = NEAR_M / source.focal_px;
  target.near = NEAR_M;
  target.far = FAR_M;
  target.projectionMatrix.makePerspective(
    (left - cx) * scale,
    (right - cx) * scale,
    (cy - top) * scale,
    (cy - bottom) * scale,
    NEAR_M,
    FAR_M,
  );
  target.projectionMatrixInverse.copy(target.projectionMatrix).invert();
}

/** Box around all vertices as they are now, morph targets included; their world matrices have to be up to date. */
export function projectedBox(meshes: Mesh[], camera: PhotoCamera): PixelBox {
  const box: PixelBox = [Infinity, Infinity, -Infinity, -Infinity];
  const [rx, ry, rz] = camera.rotation.map((row) => new Vector3(...row)) as [Vector3, Vector3, Vector3];
  const at = new Vector3();
  for (const mesh of meshes)
    for (let index = 0; index < mesh.geometry.attributes.position!.count; index++) {
      mesh.getVertexPosition(index, at).applyMatrix4(mesh.matrixWorld);
      const depth = rz.dot(at) + camera.translation[2];
      const u = (camera.focal_px * (rx.dot(at) + camera.translation[0])) / depth + camera.principal_point[0];
      const v = (camera.focal_px * (ry.dot(at) + camera.translation[1])) / depth + camera.principal_point[1];
      box[0] = Math.min(box[0], u);
      box[1] = Math.min(box[1], v);
      box[2] = Math.max(box[2], u);
      box[3] = Math.max(box[3], v);
    }
  return box;
}
