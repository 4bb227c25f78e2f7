// Expressions in motion: easing from one to the next, and a loop in which the head looks alive.

import type { HeadScene } from "./scene";

export type Weights = Record<string, number>;

const EASE_MS = 260;

export class Motion {
  /** The expression at rest: what was chosen last. */
  rest: Weights;
  private shown: Weights;
  private frame = 0;
  private running = false;

  constructor(private readonly scene: HeadScene) {
    this.rest = this.shown = { ...scene.expression };
  }

  /** Goes over to an expression, at once where motion is not wanted. */
  to(weights: Weights): void {
    const from = { ...this.shown };
    this.rest = { ...weights };
    if (this.running) return; // the loop starts from what is at rest
    cancelAnimationFrame(this.frame);
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) return this.wear(this.rest);
    const began = performance.now();
    const step = () => {
      const share = Math.min((performance.now() - began) / EASE_MS, 1);
      this.wear(mixed(from, this.rest, share * share * (3 - 2 * share)));
      if (share < 1) this.frame = requestAnimationFrame(step);
    };
    step();
  }

  /** One weight by hand, without easing. */
  set(name: string, weight: number): void {
    this.rest = { ...this.rest, [name]: weight };
    if (!this.running) this.wear(this.rest);
  }

  loop(on: boolean): void {
    cancelAnimationFrame(this.frame);
    this.running = on;
    if (!on) {
      this.scene.pose(0, 0);
      return this.wear(this.rest);
    }
    const began = performance.now();
    const step = () => {
      const seconds = (performance.now() - began) / 1000;
      const now = alive(this.rest, seconds);
      this.wear(now.weights);
      this.scene.pose(now.yaw, now.pitch);
      this.frame = requestAnimationFrame(step);
    };
    step();
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
  }

  private wear(weights: Weights): void {
    this.shown = weights;
    this.scene.express(weights);
  }
}

/** Weights, and angles of the head in radians, some seconds into the loop: blinks, glances, a smile that comes and goes. */
function alive(rest: Weights, seconds: number): { weights: Weights; yaw: number; pitch: number } {
  const wave = (period: number, phase: number) => Math.sin((2 * Math.PI * seconds) / period + phase);
  const smile = 0.45 * Math.max(0, wave(11, 0)) ** 2;
  const brows = 0.5 * Math.max(0, wave(7.3, 1)) ** 4;
  const blink = blinking(seconds);
  const [side, up] = glance(seconds);
  const added: Weights = {
    mouthSmileLeft: smile,
    mouthSmileRight: smile,
    cheekSquintLeft: 0.6 * smile,
    cheekSquintRight: 0.6 * smile,
    browInnerUp: brows,
    browOuterUpLeft: 0.7 * brows,
    browOuterUpRight: 0.7 * brows,
    jawOpen: 0.03 + 0.03 * wave(4.1, 2),
    eyeBlinkLeft: blink,
    eyeBlinkRight: blink,
    eyeLookOutLeft: Math.max(0, side),
    eyeLookInRight: Math.max(0, side),
    eyeLookInLeft: Math.max(0, -side),
    eyeLookOutRight: Math.max(0, -side),
    eyeLookUpLeft: Math.max(0, up),
    eyeLookUpRight: Math.max(0, up),
    eyeLookDownLeft: Math.max(0, -up),
    eyeLookDownRight: Math.max(0, -up),
  };
  const weights = { ...rest };
  for (const [name, more] of Object.entries(added)) weights[name] = Math.min(1, (rest[name] ?? 0) + more);
  return { weights, yaw: 0.1 * wave(9, 0) + 0.03 * wave(3.7, 1), pitch: 0.03 * wave(6.1, 2) };
}

const BLINK_S = 0.22;

/** One blink every 3.4 s, at a different moment each time. */
function blinking(seconds: number): number {
  const turn = Math.floor(seconds / 3.4);
  const since = seconds - 3.4 * turn - 0.4 - 2.4 * chance(turn);
  return since < 0 || since > BLINK_S ? 0 : Math.sin((Math.PI * since) / BLINK_S);
}

/** Where the eyes look: a new place every 1.7 s, reached in a tenth of a second. */
function glance(seconds: number): [side: number, up: number] {
  const turn = Math.floor(seconds / 1.7);
  const share = Math.min((seconds - 1.7 * turn) / 0.1, 1);
  const place = (at: number): [number, number] =>
    at % 2 ? [0.5 * (chance(at) - 0.5), 0.3 * (chance(at + 0.5) - 0.5)] : [0, 0];
  const [from, to] = [place(turn - 1), place(turn)];
  return [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])];
}

/** A number in [0, 1) that looks random and is the same each time. */
function chance(seed: number): number {
  const value = Math.sin(12.9898 * (seed + 1)) * 43758.5453;
  return value - Math.floor(value);
}

function mixed(from: Weights, to: Weights, share: number): Weights {
  const weights: Weights = {};
  for (const name of new Set([...Object.keys(from), ...Object.keys(to)]))
    weights[name] = (from[name] ?? 0) + share * ((to[name] ?? 0) - (from[name] ?? 0));
  return weights;
}
