// Lamp and room. Both stay with the viewer, so turning the camera shows the head turning in a fixed light.

import { DirectionalLight, PMREMGenerator, Scene, Vector3, type Camera, type WebGLRenderer } from "three";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";

/** Where the light stands, seen from the camera: degrees to the right and up; strengths of lamp and room. */
export interface Light {
  azimuth: number;
  elevation: number;
  strength: number;
  room: number;
}

export class Lighting {
  readonly light: Light = { azimuth: 35, elevation: 30, strength: 2.1, room: 0.45 };
  private readonly lamp = new DirectionalLight(0xffffff, 1);

  constructor(
    private readonly scene: Scene,
    renderer: WebGLRenderer,
  ) {
    const room = new RoomEnvironment();
    const generator = new PMREMGenerator(renderer);
    scene.environment = generator.fromScene(room, 0.04).texture;
    generator.dispose();
    room.dispose();
    this.lamp.castShadow = true;
    this.lamp.shadow.mapSize.set(1024, 1024);
    this.lamp.shadow.radius = 3;
    this.lamp.shadow.bias = -0.0004;
    this.lamp.shadow.normalBias = 0.002;
    scene.add(this.lamp, this.lamp.target);
  }

  move(change: Partial<Light>): void {
    Object.assign(this.light, change);
    this.light.azimuth = ((((this.light.azimuth + 180) % 360) + 360) % 360) - 180;
    this.light.elevation = Math.min(Math.max(this.light.elevation, -85), 85);
  }

  /** Shadows within so many metres about the centre. */
  cover(radius: number): void {
    const view = this.lamp.shadow.camera;
    view.left = view.bottom = -radius;
    view.right = view.top = radius;
    view.near = 1 - radius;
    view.far = 1 + radius;
    view.updateProjectionMatrix();
  }

  /** Puts the lamp where it stands for that camera; `turn` is the camera's angle about the vertical in radians. */
  place(camera: Camera, centre: Vector3, turn: number): void {
    const [azimuth, elevation] = [this.light.azimuth, this.light.elevation].map((degrees) => (degrees * Math.PI) / 180);
    const across = Math.cos(elevation!);
    const from = new Vector3(Math.sin(azimuth!) * across, Math.sin(elevation!), Math.cos(azimuth!) * across);
    camera.updateMatrixWorld();
    from.transformDirection(camera.matrixWorld);
    this.lamp.position.copy(centre).addScaledVector(from, 1);
    this.lamp.target.position.copy(centre);
    this.lamp.intensity = this.light.strength;
    this.scene.environmentIntensity = this.light.room;
    this.scene.environmentRotation.y = turn;
  }

  dispose(): void {
    this.scene.environment?.dispose();
  }
}
