// The light: a ball to drag, sliders, dragging on the head, keys.

import { byId, make } from "../dom";
import type { Fit } from "../viewer/manifest";
import type { Light } from "../viewer/lighting";
import type { HeadScene } from "../viewer/scene";
import { group, slider } from "./group";

/** Angle from the viewer's direction at the rim of the ball, in degrees: a little behind the head. */
const RIM = 135;
const STEP = 5;

const LIGHTS: [string, Partial<Light>][] = [
  ["Studio", { azimuth: 35, elevation: 30, strength: 2.1, room: 0.45 }],
  ["Window", { azimuth: -70, elevation: 15, strength: 2.8, room: 0.35 }],
  ["Rim", { azimuth: 135, elevation: 10, strength: 6, room: 0.35 }],
];

export function lightPanel(scene: HeadScene, canvas: HTMLCanvasElement, fit: Fit | null): HTMLElement {
  const panel = group("Light", true);
  const { light } = scene;
  const photo = lightOfPhoto(fit);
  const buttons = [...LIGHTS, ...(photo ? [["Photo", photo] as [string, Partial<Light>]] : [])].map(([title, to]) => {
    const button = make("button", { type: "button", class: "small" }, title);
    button.addEventListener("click", () => scene.moveLight(to));
    return button;
  });
  panel.body.append(make("div", { class: "row", role: "group", "aria-label": "Light" }, ...buttons));
  const dot = make("span", { class: "dot" });
  // For pointers only: the sliders beside it say and do the same.
  const ball = make("div", { class: "ball", "aria-hidden": true }, dot);
  const degrees = { min: -180, max: 180, step: 1, unit: "°" };
  const sliders = {
    azimuth: slider("Side", "light-azimuth", degrees, light.azimuth, (azimuth) => scene.moveLight({ azimuth })),
    elevation: slider("Height", "light-elevation", { ...degrees, min: -85, max: 85 }, light.elevation, (elevation) =>
      scene.moveLight({ elevation }),
    ),
    strength: slider("Lamp", "light-strength", { min: 0, max: 6, step: 0.05 }, light.strength, (strength) =>
      scene.moveLight({ strength }),
    ),
    room: slider("Room", "light-room", { min: 0, max: 2, step: 0.05 }, light.room, (room) => scene.moveLight({ room })),
  };
  panel.body.append(make("div", { class: "light" }, ball, make("div", {}, ...Object.values(sliders).map((one) => one.row))));

  scene.lightMoved = () => {
    for (const name of ["azimuth", "elevation", "strength", "room"] as const) sliders[name].set(Math.round(light[name] * 100) / 100);
    const [x, y] = onBall(light.azimuth, light.elevation);
    dot.style.left = `${50 + 50 * x}%`;
    dot.style.top = `${50 - 50 * y}%`;
    ball.style.setProperty("--x", `${50 + 42 * x}%`);
    ball.style.setProperty("--y", `${50 - 42 * y}%`);
  };
  scene.lightMoved();

  dragged(ball, (event) => {
    const { left, top, width, height } = ball.getBoundingClientRect();
    scene.moveLight(fromBall((2 * (event.clientX - left)) / width - 1, 1 - (2 * (event.clientY - top)) / height));
  });
  dragOnHead(scene, canvas);
  keys(scene, canvas);
  return panel.element;
}

/** The lamp where the photo's light comes from: the linear band of its spherical harmonics, whose y is down, z forward. */
export function lightOfPhoto(fit: Fit | null): Partial<Light> | null {
  const bands = fit?.light?.coefficients;
  if (!bands || bands.length < 4) return null;
  const [down, forward, right] = bands.slice(1, 4).map((colours) => colours[0] + colours[1] + colours[2]);
  const length = Math.hypot(right!, down!, forward!);
  if (length < 1e-6) return null;
  return {
    azimuth: Math.round(degreesOf(Math.atan2(right!, -forward!))),
    elevation: Math.round(degreesOf(Math.asin(-down! / length))),
    strength: 2.1,
    room: 0.6,
  };
}

/** Place on the unit disk of a light, by its angle from the viewer (azimuthal equidistant). */
function onBall(azimuth: number, elevation: number): [number, number] {
  const [a, e] = [radians(azimuth), radians(elevation)];
  const [x, y, z] = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
  const across = Math.hypot(x, y);
  if (across < 1e-6) return [0, 0];
  const radius = Math.min(Math.atan2(across, z) / radians(RIM), 1);
  return [(x / across) * radius, (y / across) * radius];
}

function fromBall(x: number, y: number): { azimuth: number; elevation: number } {
  const radius = Math.hypot(x, y);
  if (radius < 1e-6) return { azimuth: 0, elevation: 0 };
  const angle = Math.min(radius, 1) * radians(RIM);
  const [dx, dy, dz] = [(x / radius) * Math.sin(angle), (y / radius) * Math.sin(angle), Math.cos(angle)];
  return { azimuth: Math.round(degreesOf(Math.atan2(dx, dz))), elevation: Math.round(degreesOf(Math.asin(dy))) };
}

function dragOnHead(scene: HeadScene, canvas: HTMLCanvasElement): void {
  dragged(canvas, (event) => {
    if (document.querySelector<HTMLInputElement>("input[name=drag][value=light]")?.checked !== true || !event.isPrimary) return;
    const { azimuth, elevation } = scene.light;
    scene.moveLight({ azimuth: azimuth + event.movementX * 0.5, elevation: elevation - event.movementY * 0.5 });
  });
}

function keys(scene: HeadScene, canvas: HTMLCanvasElement): void {
  const arrows: Record<string, [number, number]> = {
    ArrowLeft: [-1, 0],
    ArrowRight: [1, 0],
    ArrowUp: [0, 1],
    ArrowDown: [0, -1],
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = arrows[event.key];
    if (arrow && event.shiftKey)
      scene.moveLight({ azimuth: scene.light.azimuth + STEP * arrow[0], elevation: scene.light.elevation + STEP * arrow[1] });
    else if (arrow) scene.turn(-STEP * arrow[0], -STEP * arrow[1]);
    else if (event.key === "+" || event.key === "=") scene.turn(0, 0, 1.1);
    else if (event.key === "-") scene.turn(0, 0, 1 / 1.1);
    else if (event.key === "Home") scene.front();
    else return;
    event.preventDefault();
  });
  byId("reset-view").onclick = () => scene.front();
}

function dragged(element: HTMLElement, moved: (event: PointerEvent) => void): void {
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    if (element.classList.contains("ball")) moved(event);
  });
  element.addEventListener("pointermove", (event) => {
    if (element.hasPointerCapture(event.pointerId)) moved(event);
  });
}

function radians(degrees: number): number {
  return (degrees * Math.PI) / 180;
}

function degreesOf(angle: number): number {
  return (angle * 180) / Math.PI;
}
