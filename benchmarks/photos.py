"""Run the program on a folder of photos: ``python -m benchmarks.photos FOLDER -o OUT``.

Writes an archive per photo, ``overlays.png`` and ``sheets.png`` with all previews for a human to look at, and
``photos.json``; prints a table of exit status, landmark error, yaw, identity and warnings. The identity columns are the
distance and the centred cosine between photo and frontal render; the last line says what the same numbers are between
different people, since alone they mean nothing.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")


def make(photo: Path, archive: Path, quality: str = "standard") -> dict[str, Any]:
    """One run of the command line; its JSON with ``status`` and, where it failed, ``error``."""
    command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(archive), "--json", "--quality", quality]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    out: dict[str, Any] = {"photo": photo.name, "status": done.returncode}
    try:
        out |= json.loads(done.stdout)
    except ValueError:
        out["error"] = done.stderr.strip().splitlines()[-1:] or ["no output"]
    return out


def manifest_of(archive: Path) -> dict[str, Any]:
    """The archive's manifest."""
    with zipfile.ZipFile(archive) as opened:
        return dict(json.loads(opened.read("manifest.json")))


def preview_of(archive: Path, name: str) -> Image:
    """(h, w, 3) BGR of a preview."""
    import cv2

    with zipfile.ZipFile(archive) as opened:
        image = cv2.imdecode(np.frombuffer(opened.read(f"preview/{name}.jpg"), np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise SystemExit(f"{archive}: preview/{name}.jpg cannot be read")
    return np.asarray(image, np.uint8)


def contact_sheet(images: list[Image], columns: int, width: int) -> Image:
    """All images at one width, in rows as tall as their tallest."""
    import cv2

    small = [cv2.resize(i, (width, max(1, round(i.shape[0] * width / i.shape[1]))), interpolation=3) for i in images]
    rows = []
    for start in range(0, len(small), columns):
        line = small[start : start + columns]
        tall = max(i.shape[0] for i in line)
        padded = [np.pad(i, ((0, tall - i.shape[0]), (0, 0), (0, 0)), constant_values=255) for i in line]
        padded += [np.full((tall, width, 3), 255, np.uint8)] * (columns - len(line))
        rows.append(np.concatenate(padded, 1))
    return np.asarray(np.concatenate(rows), np.uint8)


def table(results: list[dict[str, Any]]) -> list[str]:
    """A line per photo."""
    lines = [f"{'photo':34} exit  rms%   yaw  dist  cos   warnings"]
    for r in results:
        if r["status"]:
            fault = r.get("error", "")
            said = f"{fault['code']}: {fault['message']}" if isinstance(fault, dict) else str(fault)
            lines.append(f"{r['photo']:34} {r['status']:4}  {said}")
            continue
        fit, alike = r["manifest_fit"], r["manifest_fit"]["identity_similarity"]
        yaw = r["fit"]["yaw_pitch_roll_deg"][0]
        lines.append(
            f"{r['photo']:34} {r['status']:4} {100 * fit['landmark_rms_iod']:5.2f} {yaw:6.1f}"
            f" {alike['distance']:5.2f} {alike['centred_cosine']:5.2f}  {' '.join(r['warnings'])}"
        )
    return lines


def main() -> None:
    """Entry point."""
    import cv2

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--quality", default="standard")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    photos = sorted(p for p in arguments.folder.iterdir() if p.suffix.lower() in SUFFIXES)
    if not photos:
        raise SystemExit(f"{arguments.folder}: no photos ({', '.join(SUFFIXES)})")
    results = []
    archives = []
    for photo in photos:
        archive = arguments.out / f"{photo.stem}.zip"
        result = make(photo, archive, arguments.quality)
        if not result["status"]:
            result["manifest_fit"] = manifest_of(archive)["fit"]
            archives.append(archive)
        results.append(result)
    if archives:
        for name, columns, width in (("overlay", 2, 800), ("sheet", 4, 682)):
            page = contact_sheet([preview_of(a, name) for a in archives], columns, width)
            cv2.imwrite(str(arguments.out / f"{name}s.png"), page)
    (arguments.out / "photos.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    lines = table(results)
    good = [r["manifest_fit"]["identity_similarity"] for r in results if not r["status"]]
    if good:
        lines.append(
            f"own render: distance {np.median([g['distance'] for g in good]):.2f},"
            f" centred cosine {np.median([g['centred_cosine'] for g in good]):.2f} (medians)"
        )
        lines.append("between different people: " + ", ".join(f"{k} {v:.2f}" for k, v in good[0]["impostor"].items()))
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
