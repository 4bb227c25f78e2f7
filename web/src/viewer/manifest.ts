// What this page reads of an archive's manifest.json; docs/archive.md and docs/manifest.schema.json have all of it.

import type { Options } from "../api";

export interface MapEntry {
  path: string;
  role: string;
  colour_space: string;
  bits: number;
  width: number;
  height: number;
  size: number;
  frame: string | null;
  coding: { zero: number; scale: number; meaning: string };
}

/** Photo pixels from head space: (x, y, z) = rotation X + translation, pixel = focal_px (x, y) / z + principal_point. */
export interface PhotoCamera {
  width: number;
  height: number;
  focal_px: number;
  principal_point: [number, number];
  rotation: [Triple, Triple, Triple];
  translation: Triple;
  yaw_pitch_roll_deg: Triple;
}

export interface UsedPhoto {
  sha256: string;
  camera: PhotoCamera;
  used_for: string[];
  texture_share: number;
}

export type Triple = [number, number, number];

export interface Likeness {
  distance: number;
  centred_cosine: number;
  impostor: { distance_p05: number; centred_cosine_p95: number };
}

export type Box = [left: number, top: number, right: number, bottom: number];

export interface Hair {
  kind: string;
  /** Of every kind, likeliest first. */
  probabilities: Record<string, number>;
  /** Overlap with the hair in the photo. */
  agreement: number;
  doubts: string[];
}

export interface Fit {
  landmark_rms_px: number;
  landmark_rms_iod?: number;
  visible_fraction: number;
  identity_similarity: Likeness | null;
  light?: { coefficients: Triple[] } | null;
  warnings: string[];
}

export interface Manifest {
  maps: MapEntry[];
  files: { path: string; role: string; size: number }[];
  displacement: { scale_mm: number; mid: number } | null;
  options?: Options;
  /** The photo that `camera` belongs to, of several the best. */
  input?: { sha256: string } | null;
  photos?: UsedPhoto[];
  left_out?: { sha256: string; message: string }[];
  /** Where preview/overlay.jpg has which part of the photo. */
  overlay?: { crop: Box; panel: Box } | null;
  hair?: Hair | null;
  camera: PhotoCamera | null;
  fit: Fit | null;
  head: { name: string; vertices: number };
  warnings?: string[];
}
