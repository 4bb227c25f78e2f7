// What this page reads of an archive's manifest.json; docs/archive.md and docs/manifest.schema.json have all of it.

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

export interface Manifest {
  maps: MapEntry[];
  files: { path: string; role: string; size: number }[];
  displacement: { scale_mm: number; mid: number } | null;
  fit: {
    landmark_rms_px: number;
    visible_fraction: number;
    identity_similarity: { centred_cosine: number; impostor: { centred_cosine_p95: number } } | null;
    warnings: string[];
  };
  head: { name: string; vertices: number };
  warnings?: string[];
}
