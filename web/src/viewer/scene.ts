// The head, its light and the camera. Draws only when something changed.

import {
  Box3,
  Color,
  Group,
  Mesh,
  MeshBasicMaterial,
  NeutralToneMapping,
  PCFShadowMap,
  PerspectiveCamera,
  Scene,
  Spherical,
  SRGBColorSpace,
  Vector3,
  WebGLRenderer,
  type Material,
  type MeshStandardMaterial,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Lighting, type Light } from "./lighting";
import { drawable, loadHead, onChart } from "./load";
import type { PhotoCamera } from "./manifest";
import type { MapStore } from "./maps";
import { lookThrough, projectedBox, type PixelBox } from "./photo_camera";
import { MapSurface, Skin, type Surface } from "./skin";

const FIELD_OF_VIEW = 24;

/** Pictures of the file that are coded as the map of that name is; normals have another zero in glTF, gloss other channels. */
const AS_THE_MAP = ["texture", "diffuse_albedo"];

/** Place of the neck's joint in head space, in metres, about which the head nods and turns; roughly. */
const NECK = new Vector3(0, -0.12, -0.09);

export class HeadScene {
  readonly light: Light;
  readonly controls: OrbitControls;
  expression: Record<string, number> = {};
  photoExpression: Record<string, number> = {};
  lightMoved: () => void = () => undefined;
  /** Told of each frame while the canvas still has it. */
  drawn: (canvas: HTMLCanvasElement) => void = () => undefined;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.05, 10);
  /** The photo's camera, and whether the view looks through it. */
  private readonly photoCamera = new PerspectiveCamera();
  private throughPhoto = false;
  private readonly neck = new Group();
  private readonly lighting: Lighting;
  private readonly watcher: ResizeObserver;
  /** Each part of the head with its lit material: the maps of the archive where the chart covers it, else the one of the file. */
  private readonly parts: { mesh: Mesh; own: Skin | MeshStandardMaterial; wires: Mesh }[] = [];
  private readonly centre = new Vector3();
  private store: MapStore | null = null;
  private distance = 1;
  private frame = 0;
  /** Degrees per second that the camera goes round by itself. */
  private speed = 0;
  private last = 0;

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = SRGBColorSpace;
    this.renderer.toneMapping = NeutralToneMapping;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.lighting = new Lighting(this.scene, this.renderer);
    this.light = this.lighting.light;
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enablePan = false;
    this.controls.enableDamping = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.controls.addEventListener("change", () => this.draw());
    this.watcher = new ResizeObserver(() => this.fit());
    this.watcher.observe(canvas.parentElement!);
    canvas.addEventListener("webglcontextrestored", () => this.draw());
  }

  textureLimit(): number {
    const small = Math.min(screen.width, screen.height) < 700;
    return Math.min(this.renderer.capabilities.maxTextureSize, small ? 1536 : 3072);
  }

  async load(data: ArrayBuffer, store: MapStore): Promise<void> {
    const head = await loadHead(data);
    this.store = store;
    for (const [name, bitmap] of head.pictures)
      if (AS_THE_MAP.includes(name) || !store.maps.length) store.seed(name, bitmap);
    for (const mesh of head.meshes) {
      const own = onChart(mesh.material) ? new Skin(mesh.material) : drawable(mesh.material);
      mesh.material = own;
      mesh.castShadow = mesh.receiveShadow = !own.transparent;
      mesh.frustumCulled = false;
      const wires = new Mesh(
        mesh.geometry,
        new MeshBasicMaterial({ wireframe: true, color: 0x0b4f4c, transparent: true, opacity: 0.45, toneMapped: false }),
      );
      wires.morphTargetInfluences = mesh.morphTargetInfluences;
      wires.morphTargetDictionary = mesh.morphTargetDictionary;
      wires.visible = false;
      mesh.add(wires);
      this.parts.push({ mesh, own, wires });
    }
    head.group.position.copy(NECK).negate();
    this.neck.position.copy(NECK);
    this.neck.add(head.group);
    this.scene.add(this.neck);
    this.photoExpression = head.expression;
    this.express(head.expression);
    this.scene.updateMatrixWorld(true);
    const box = new Box3();
    const hair = new Box3();
    for (const { mesh } of this.parts) (mesh.name.startsWith("hair") ? hair : box).expandByObject(mesh);
    hair.min.y = Math.max(hair.min.y, box.min.y); // hair that hangs lower does not make the head smaller
    this.frameHead(box.union(hair));
    this.fit();
  }

  /** Names of the blendshapes, in the file's order. */
  blendshapes(): string[] {
    return Object.keys(this.parts[0]?.mesh.morphTargetDictionary ?? {});
  }

  express(weights: Record<string, number>): void {
    this.expression = { ...weights };
    for (const { mesh } of this.parts)
      for (const [name, index] of Object.entries(mesh.morphTargetDictionary ?? {}))
        mesh.morphTargetInfluences![index] = weights[name] ?? 0;
    this.draw();
  }

  /** Turns the head on its neck, angles in radians; the camera stays. */
  pose(yaw: number, pitch: number): void {
    this.neck.rotation.set(pitch, yaw, 0);
    this.draw();
  }

  /** Box of the head without hair and bust in the photo's pixels, with the expression that it wears now. */
  boxInPhoto(camera: PhotoCamera): PixelBox {
    this.scene.updateMatrixWorld();
    const head = this.parts.filter((part) => part.own instanceof Skin);
    return projectedBox((head.length ? head : this.parts).map((part) => part.mesh), camera);
  }

  /** Looks at the head as the photo does, at this part of it; null goes back to the free view. */
  lookAsPhoto(camera: PhotoCamera, window: PixelBox | null): void {
    this.throughPhoto = window !== null;
    this.controls.enabled = window === null;
    if (window) lookThrough(this.photoCamera, camera, window);
    this.draw();
  }

  wear(surface: Surface): void {
    for (const { mesh, own } of this.parts) {
      if (mesh.material !== own) (mesh.material as Material).dispose();
      mesh.material = own;
      mesh.visible = true;
      if (own instanceof Skin) own.wear(surface);
    }
    this.draw();
  }

  /** One map as it is, on the parts that the chart covers; the others are hidden. */
  inspect(surface: () => MapSurface): void {
    for (const { mesh, own } of this.parts) {
      if (mesh.material !== own) (mesh.material as Material).dispose();
      if (own instanceof Skin) mesh.material = surface();
      else mesh.visible = false;
    }
    this.draw();
  }

  wireframe(on: boolean): void {
    for (const part of this.parts) part.wires.visible = on;
    this.draw();
  }

  moveLight(change: Partial<Light>): void {
    this.lighting.move(change);
    this.lightMoved();
    this.draw();
  }

  /** Turns the camera around the head, angles in degrees; `nearer` divides the distance. */
  turn(right: number, up: number, nearer = 1): void {
    const place = new Spherical().setFromVector3(this.camera.position.clone().sub(this.centre));
    place.theta += (right * Math.PI) / 180;
    place.phi = Math.min(Math.max(place.phi - (up * Math.PI) / 180, 0.15), Math.PI - 0.15);
    place.radius = Math.min(Math.max(place.radius / nearer, this.controls.minDistance), this.controls.maxDistance);
    this.camera.position.setFromSpherical(place).add(this.centre);
    this.controls.update();
    this.draw();
  }

  front(): void {
    this.camera.position.copy(this.centre).add(new Vector3(0, 0, this.distance));
    this.controls.update();
    this.draw();
  }

  get spinning(): boolean {
    return this.speed !== 0;
  }

  /** Turns the head round at so many degrees per second; 0 stops. */
  spin(speed: number): void {
    this.speed = speed;
    this.last = performance.now();
    this.draw();
  }

  /** A colour behind the head; null for none. */
  background(colour: string | null): void {
    this.scene.background = colour ? new Color(colour) : null;
    this.draw();
  }

  /** Has what is seen now copied; of what was drawn before the canvas has nothing left. */
  capture(copy: (canvas: HTMLCanvasElement) => void): void {
    this.render();
    copy(this.canvas);
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.watcher.disconnect();
    this.controls.dispose();
    this.store?.dispose();
    for (const { mesh, own, wires } of this.parts) {
      mesh.geometry.dispose();
      if (!(own instanceof Skin)) own.map?.dispose();
      own.dispose();
      (wires.material as Material).dispose();
    }
    this.lighting.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  draw(): void {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.controls.update(); // damping goes on by the change that it reports
      this.render();
      if (this.spinning) {
        const now = performance.now();
        this.turn((this.speed * (now - this.last)) / 1000, 0);
        this.last = now;
      }
    });
  }

  private render(): void {
    const camera = this.throughPhoto ? this.photoCamera : this.camera;
    this.lighting.place(camera, this.centre, this.controls.getAzimuthalAngle());
    this.renderer.render(this.scene, camera);
    this.drawn(this.canvas);
    this.canvas.dataset.frames = String(this.renderer.info.render.frame);
  }

  private frameHead(box: Box3): void {
    box.getCenter(this.centre);
    const size = box.getSize(new Vector3());
    const radius = size.length() / 2;
    this.distance = (0.545 * size.y) / Math.tan((FIELD_OF_VIEW * Math.PI) / 360);
    this.controls.target.copy(this.centre);
    this.controls.minDistance = 0.9 * radius;
    this.controls.maxDistance = 2.5 * this.distance;
    this.lighting.cover(radius);
    this.front();
  }

  private fit(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement!;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // A view higher than wide keeps the head's width in view.
    this.camera.zoom = Math.min(1, (width / height) * 1.2);
    this.camera.updateProjectionMatrix();
    this.draw();
  }
}
