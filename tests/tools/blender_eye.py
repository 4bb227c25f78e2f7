"""Run by Blender's Python: an eye of a GLB, close, under a key light of half a metre, in Cycles and in EEVEE.

    python blender_eye.py HEAD.glb OUT WATTS

OUT gets CYCLES.png and EEVEE.png, 16 mm of the face wide, the right eye's centre in their middle.
"""

import math
import sys
from pathlib import Path

from blender_stage import aimed, camera, corners, cycles, drawn, lamp, opened, sky

SIZE, FIELD_M, AWAY_M = 128, 0.016, 1.0
KEY_AT, KEY_M, SKY = (-0.4, -0.8, 0.18), 0.5, (0.1, 0.1, 0.11)


def main() -> None:
    ball = next(one for one in opened(Path(sys.argv[1])) if one.name.startswith("eye_right_ball"))
    first, *others = corners([ball])
    eye = sum(others, first) / 8
    scene = cycles(SIZE, SIZE, samples=48, bounces=3, seed=3)
    sky(*SKY)
    lamp(eye, KEY_AT, float(sys.argv[3]), KEY_M)
    aimed(camera(2 * math.atan(FIELD_M / 2 / AWAY_M)), eye, (0.0, -AWAY_M, 0.0))
    for engine in ("CYCLES", "BLENDER_EEVEE"):
        scene.render.engine = engine
        drawn(Path(sys.argv[2]) / f"{engine.removeprefix('BLENDER_')}.png")


main()
