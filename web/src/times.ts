// How long a head takes at each quality, before it is started.

import { duration } from "./dom";

export interface Level {
  name: string;
  size: number[];
  expected: Expected | null;
}

export interface Expected {
  seconds: number;
  /** Whether jobs of this kind took so long on this server; else it is worked out from others. */
  measured: boolean;
}

/**
 * Seconds from photo to archive on two cores: `make speed` of the sample photo; what `high` and `reference` take beside
 * `standard` is from docs/accuracy-time.md.
 */
const ON_TWO_CORES: Record<string, number> = { draft: 7.4, standard: 26.8, high: 31.3, reference: 40.7 };

/** Seconds of the stages that a texture needs, as a share of a draft: the same table, seconds without networks. */
const WITHOUT_NETWORKS = 0.45;

/** Reads what GET /v1/quality answers; levels that nobody made here yet are estimated from those that were. */
export function readLevels(content: unknown): Level[] {
  const given = (typeof content === "object" && content !== null ? content : {}) as Record<string, unknown>;
  const rows = (name: string) => (Array.isArray(given[name]) ? given[name] : []) as Record<string, unknown>[];
  const levels = rows("levels").map((level) => {
    const size = (Array.isArray(level.size) ? level.size : []).map(Number);
    const row = rows("items").find((item) => item.quality === level.name && String(item.size) === String(size));
    const seconds = typeof row?.median_s === "number" && row.median_s > 0 ? row.median_s : null;
    return { name: String(level.name), size, expected: seconds === null ? null : { seconds, measured: true } };
  });
  const ratios = levels.flatMap((level) => {
    const usual = ON_TWO_CORES[level.name];
    return usual && level.expected ? [level.expected.seconds / usual] : [];
  });
  const pace = ratios.length ? ratios.reduce((sum, ratio) => sum + ratio, 0) / ratios.length : 1;
  return levels.map((level) => {
    const usual = ON_TWO_CORES[level.name];
    return level.expected || !usual ? level : { ...level, expected: { seconds: usual * pace, measured: false } };
  });
}

/** What a job of these levels takes when only the texture is made. */
export function withoutReflectance(levels: Level[]): Expected | null {
  const draft = levels.find((level) => level.name === "draft")?.expected;
  return draft ? { seconds: WITHOUT_NETWORKS * draft.seconds, measured: false } : null;
}

/** Seconds of one more photo of the same person, on two cores: docs/several-photos.md. */
const MORE_PHOTO = 2;

/** The time with so many photos more. */
export function withMorePhotos(one: Expected | null, more: number): Expected | null {
  return one && more > 0 ? { seconds: one.seconds + MORE_PHOTO * more, measured: false } : one;
}

/** "about" for what was measured here, "roughly" for what was worked out. */
export function timeInWords(expected: Expected | null): string {
  if (!expected) return "";
  return expected.measured ? `about ${duration(expected.seconds)}` : `roughly ${duration(rounded(expected.seconds))}`;
}

/** What the two words mean, for the note under the choices. */
export function noteOnTimes(levels: Level[]): string {
  const known = levels.filter((level) => level.expected);
  if (!known.length) return "";
  if (known.every((level) => level.expected!.measured)) return "Times are those of the last heads made on this server.";
  if (known.some((level) => level.expected!.measured))
    return "“About” is what the last heads took on this server; “roughly” is worked out from them.";
  return "No head was made on this server yet: times are those of a machine with two cores.";
}

function rounded(seconds: number): number {
  const step = seconds < 20 ? 1 : 5;
  return Math.max(1, Math.round(seconds / step)) * step;
}
