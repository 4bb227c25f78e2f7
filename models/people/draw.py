"""Drawing with OpenGL, off screen: Mesa's llvmpipe or a graphics card, through EGL.

A scene is a list of meshes in head space. Three passes see the same meshes: depth as a lamp sees them (shadows), what
each pixel centre shows (truth), and light (at twice the size, averaged).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any, Protocol

import moderngl
import numpy as np
import numpy.typing as npt

from models.people.shaders import KINDS, MOST_LAMPS, RADIANCE, SHADOW, TRUTH, VERTEX
from models.people.strand_shaders import strand_programs
from service.errors import ModelFault
from service.geometry.camera import Camera

Float = npt.NDArray[np.float32]

NEAR_M, FAR_M = 0.02, 30.0
SHADOW_SIZE = 512
"""Side of a lamp's depth map, pixels."""
TWICE = 2
"""Light is drawn this many times finer than the portrait in each direction."""
_FIELDS = ("position", "normal", "uv", "ambient", "chart")
_FORMAT = "3f 3f 4f 4f 2f"


@dataclass
class Mesh:
    """One thing to be drawn.

    Attributes:
        kind: material, a key of ``KINDS``.
        position, normal: (N, 3) float32, head space, metres.
        triangles: (T, 3) int32.
        uv: (N, 4) float32: picture coordinates and what the material makes of the rest.
        ambient: (N, 4) float32 irradiance from the surroundings, and the share of them that is seen.
        chart: (N, 2) float32 chart coordinates.
        label: part that its pixels show (skin and eyes tell theirs themselves).
        charted: whether its pixels have chart coordinates.
        picture: key of a texture that was given to the renderer, or "".
        uniforms: values of uniforms for this mesh alone.
        shadows: whether it casts shadows; visible: whether it is drawn; true: whether the truth shows it.
        only_label: the truth keeps what lies behind and changes the part alone.
    """

    kind: str
    position: Float
    normal: Float
    triangles: npt.NDArray[np.int32]
    uv: Float
    label: int
    chart: Float | None = None
    charted: bool = False
    ambient: Float | None = None
    picture: str = ""
    uniforms: dict[str, Any] = field(default_factory=dict)
    shadows: bool = True
    true: bool = True
    only_label: bool = False

    def packed(self) -> Float:
        """(N, 16) float32 rows of all attributes."""
        n = len(self.position)
        ambient = np.ones((n, 4), np.float32) if self.ambient is None else self.ambient
        chart = np.zeros((n, 2), np.float32) if self.chart is None else self.chart
        return np.ascontiguousarray(
            np.concatenate([self.position, self.normal, self.uv, ambient, chart], 1), np.float32
        )


def clip_matrix(camera: Camera) -> npt.NDArray[np.float64]:
    """(4, 4) from head space to clip space, such that row 0 of what is read back is the top row."""
    f, (cx, cy) = camera.focal_px, camera.principal_point
    w, h, a = camera.width, camera.height, (FAR_M + NEAR_M) / (FAR_M - NEAR_M)
    project = np.array([
        [2 * f / w, 0, 2 * cx / w - 1, 0], [0, 2 * f / h, 2 * cy / h - 1, 0],
        [0, 0, a, -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)], [0, 0, 1, 0],
    ])  # fmt: skip
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = camera.rotation, camera.translation
    return np.asarray(project @ view)


def lamp_matrix(at: npt.NDArray[np.float64], radius: float = 0.24) -> npt.NDArray[np.float64]:
    """(4, 4) clip matrix of a lamp at (3,) metres that sees the ball of ``radius`` about the head's middle."""
    middle = np.array([0.0, -0.05, -0.06])
    forward = middle - at
    distance = float(np.linalg.norm(forward))
    forward = forward / distance
    side = np.cross(forward, [0.0, 1.0, 0.0] if abs(forward[1]) < 0.95 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, forward)
    near, far = max(distance - 0.5, 0.05), distance + 0.5
    spread = np.sqrt(max(distance**2 - radius**2, 0.01)) / radius
    view = np.eye(4)
    view[:3, :3] = np.stack([side, up, forward])
    view[:3, 3] = -view[:3, :3] @ at
    project = np.array([
        [spread, 0, 0, 0], [0, spread, 0, 0], [0, 0, (far + near) / (far - near), -2 * far * near / (far - near)],
        [0, 0, 1, 0],
    ])  # fmt: skip
    return np.asarray(project @ view)


def specialised(text: str, name: str, kind: int) -> str:
    """A fragment shader for one material; branches on constants cost a software renderer nothing."""
    return text.replace("KIND", str(kind)).replace("SOFTNESS", "1.5" if name == "truth" else "0.0")


class Lines(Protocol):
    """Hair as the renderer takes it (``models.people.strands.Strands``)."""

    programs: dict[str, Any]
    gloss: float

    def cast(self, matrix: npt.NDArray[np.floating]) -> None:
        """Draw it into a depth map by a clip matrix (4, 4)."""

    def draw(self) -> None:
        """Draw light, direction and normal into the bound target."""


class Renderer:
    """OpenGL context with programs, buffers and textures; make it once (``renderer()``)."""

    def __init__(self) -> None:
        try:
            settings: dict[str, Any] = {"standalone": True, "backend": "egl"}
            self.gl: Any = moderngl.create_context(**settings)
        except Exception as fault:  # the library raises plain Exception where there is no EGL
            raise ModelFault(
                f"no OpenGL through EGL ({fault}): install libegl1 and libgl1-mesa-dri, or a driver"
            ) from fault
        self.programs = {
            (name, kind): self.gl.program(vertex_shader=VERTEX, fragment_shader=specialised(text, name, number))
            for name, text in (("radiance", RADIANCE), ("truth", TRUTH), ("shadow", SHADOW))
            for kind, number in KINDS.items()
        }
        self.strand_programs = strand_programs(self.gl)
        self.textures: dict[str, Any] = {}
        self.targets: dict[tuple[str, int], Any] = {}
        self.buffers: list[Any] = []
        self.lamp_depth = self.gl.depth_texture((MOST_LAMPS * SHADOW_SIZE, SHADOW_SIZE))
        self.lamp_depth.compare_func = ""
        self.lamp_depth.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.lamp_target = self.gl.framebuffer(depth_attachment=self.lamp_depth)
        self.put("none", np.full((1, 1, 4), 255, np.uint8))
        self.depth_atlas: Any = None

    def put(
        self, name: str, image: npt.NDArray[Any], mipmaps: bool = True, keep: bool = True, repeat: bool = False
    ) -> None:
        """Give a picture (H, W, C) uint8 or float32, row 0 = top, under a name; one given with ``keep`` stays."""
        if keep and name in self.textures:
            return
        if name in self.textures:
            self.textures.pop(name).release()
        kind = "f1" if image.dtype == np.uint8 else "f4"
        flipped = np.ascontiguousarray(image[::-1])
        texture = self.gl.texture(
            (image.shape[1], image.shape[0]), image.shape[2], flipped.tobytes(), alignment=1, dtype=kind
        )
        if mipmaps:
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        else:
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = repeat
        self.textures[name] = texture

    def _target(self, kind: str, size: int) -> Any:
        if (kind, size) not in self.targets:
            colours = [self.gl.texture((size, size), 4, dtype="f4") for _ in range(3)]
            self.targets[kind, size] = self.gl.framebuffer(colours, self.gl.depth_renderbuffer((size, size)))
        return self.targets[kind, size]

    def load(self, meshes: list[Mesh]) -> list[dict[str, Any]]:
        """Send meshes to the card: for each the vertex arrays of all programs. ``clear`` frees them."""
        loaded = []
        for mesh in meshes:
            vertices = self.gl.buffer(mesh.packed().tobytes())
            index = self.gl.buffer(np.ascontiguousarray(mesh.triangles, np.int32).tobytes())
            self.buffers += [vertices, index]
            arrays = {}
            for name in ("radiance", "truth", "shadow"):
                program = self.programs[name, mesh.kind]
                known = [f if f in program else None for f in _FIELDS]
                layout = " ".join(
                    part if f else f"{4 * int(part[0])}x" for part, f in zip(_FORMAT.split(), known, strict=True)
                )
                content = [(vertices, layout, *(f for f in known if f))]
                arrays[name] = self.gl.vertex_array(program, content, index, skip_errors=True)
            self.buffers += list(arrays.values())
            loaded.append(arrays)
        return loaded

    def clear(self) -> None:
        """Free what ``load`` made."""
        for buffer in self.buffers:
            buffer.release()
        self.buffers = []

    def _set(self, program: Any, values: dict[str, Any]) -> None:
        for name, value in values.items():
            if name not in program:
                continue
            if isinstance(value, np.ndarray):
                value = np.asarray(value, np.float32)
                program[name].write(
                    value.T.tobytes() if value.ndim == 2 and value.shape[0] == value.shape[1] else value.tobytes()
                )
            else:
                program[name].value = value

    def _bind(self, program: Any, names: dict[str, Any]) -> None:
        for unit, (name, texture) in enumerate(names.items()):
            if name in program:
                texture.use(unit)
                program[name].value = unit

    def _draw(self, name: str, meshes: list[Mesh], loaded: list[dict[str, Any]], shared: dict[str, Any]) -> None:
        ready = set()
        for mesh, arrays in zip(meshes, loaded, strict=True):
            program = self.programs[name, mesh.kind]
            if mesh.kind not in ready:
                self._set(program, shared)
                ready.add(mesh.kind)
            self._set(program, {"label": mesh.label, "charted": float(mesh.charted), **mesh.uniforms})
            self._bind(program, {**self._maps(), "picture": self.textures[mesh.picture or "none"]})
            arrays[name].render()

    def shadows(
        self,
        meshes: list[Mesh],
        loaded: list[dict[str, Any]],
        matrices: list[npt.NDArray[np.float64]],
        shared: dict[str, Any],
        hair: Lines | None = None,
    ) -> None:
        """Fill the lamps' depth maps."""
        if matrices:
            self._depths(self.lamp_target, meshes, loaded, matrices, SHADOW_SIZE, MOST_LAMPS, shared, hair)

    def _depths(
        self,
        target: Any,
        meshes: list[Mesh],
        loaded: list[dict[str, Any]],
        matrices: Any,
        size: int,
        across: int,
        shared: dict[str, Any],
        hair: Lines | None = None,
    ) -> None:
        target.use()
        target.viewport = (0, 0, *target.size)
        target.clear(depth=1.0)
        self.gl.enable_only(moderngl.DEPTH_TEST)
        for mesh, arrays in zip(meshes, loaded, strict=True):
            if not mesh.shadows:
                continue
            program: Any = self.programs["shadow", mesh.kind]
            self._set(program, {**shared, **mesh.uniforms, "lift": 0.0})
            self._bind(program, {**self._maps(), "picture": self.textures[mesh.picture or "none"]})
            for k, matrix in enumerate(matrices):
                target.viewport = (k % across * size, k // across * size, size, size)
                program["toClip"].write(np.asarray(matrix, np.float32).T.tobytes())
                arrays["shadow"].render()
        if hair is not None:
            for k, matrix in enumerate(matrices):
                target.viewport = (k % across * size, k // across * size, size, size)
                hair.cast(matrix)
        target.viewport = (0, 0, *target.size)

    def depths(
        self,
        meshes: list[Mesh],
        loaded: list[dict[str, Any]],
        matrices: npt.NDArray[np.float64],
        size: int,
        shared: dict[str, Any],
        hair: Lines | None = None,
    ) -> Float:
        """(N, size, size) float32 depth in [0, 1], row 0 = bottom, as seen by (N, 4, 4) clip matrices."""
        across = 6
        rows = -(-len(matrices) // across)
        if self.depth_atlas is None or self.depth_atlas.size != (across * size, rows * size):
            texture = self.gl.depth_texture((across * size, rows * size))
            self.depth_atlas = self.gl.framebuffer(depth_attachment=texture)
            self.depth_atlas_texture = texture
        self._depths(self.depth_atlas, meshes, loaded, matrices, size, across, shared, hair)
        image = np.frombuffer(self.depth_atlas_texture.read(), np.float32).reshape(rows, size, across, size)
        return np.asarray(image.transpose(0, 2, 1, 3).reshape(-1, size, size)[: len(matrices)])

    def _maps(self) -> dict[str, Any]:
        names = ("layers", "strands", "places", "gobo", "sky", "iris", "made")
        maps = {name: self.textures.get(name, self.textures["none"]) for name in names}
        return {**maps, "shadow": self.lamp_depth}

    def radiance(
        self,
        meshes: list[Mesh],
        loaded: list[dict[str, Any]],
        camera: Camera,
        shared: dict[str, Any],
        hair: Lines | None = None,
    ) -> tuple[Float, Float, Float]:
        """What the portrait shows, averaged from twice the size.

        Returns:
            (H, W, 4) float32 linear light and cover; of strands (H, W, 4) direction in the picture, depth and cover,
            and (H, W, 4) normal in camera space and cover, all sums over covered samples divided by their whole number.
        """
        size = camera.width * TWICE
        target = self._target("radiance", size)
        target.use()
        target.color_mask = ((True,) * 4,) * 3
        target.clear(0.0, 0.0, 0.0, 0.0)
        target.color_mask = ((True,) * 4, (False,) * 4, (False,) * 4)
        shared = {**shared, "toClip": clip_matrix(camera), "faint": 0.1}
        solid = [k for k, m in enumerate(meshes) if m.kind not in ("lens", "lash", "brow")]
        glass = [k for k, m in enumerate(meshes) if m.kind in ("lash", "brow")] + [
            k for k, m in enumerate(meshes) if m.kind == "lens"
        ]
        self.gl.enable_only(moderngl.DEPTH_TEST)
        self._draw("radiance", [meshes[k] for k in solid], [loaded[k] for k in solid], shared)
        if hair is not None:
            target.color_mask = ((True,) * 4,) * 3
            program = hair.programs["draw"]
            turn, shift = np.asarray(camera.rotation), np.asarray(camera.translation)
            self._set(program, {**shared, "toCameraTurn": turn, "toCameraShift": shift, "gloss": hair.gloss})
            self._bind(program, {"shadow": self.lamp_depth})
            hair.draw()
            target.color_mask = ((True,) * 4, (False,) * 4, (False,) * 4)
        self.gl.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self.gl.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        target.depth_mask = False
        self._draw("radiance", [meshes[k] for k in glass], [loaded[k] for k in glass], shared)
        target.depth_mask = True
        target.color_mask = ((True,) * 4,) * 3

        def averaged(attachment: int) -> Float:
            values = np.frombuffer(target.read(components=4, attachment=attachment, dtype="f4"), np.float32)
            return _halved(values.reshape(size, size, 4))

        light = averaged(0)
        return light, *((averaged(1), averaged(2)) if hair is not None else (np.zeros_like(light),) * 2)

    def truth(
        self, meshes: list[Mesh], loaded: list[dict[str, Any]], camera: Camera, shared: dict[str, Any]
    ) -> tuple[Float, Float, Float]:
        """Three (H, W, 4) float32 buffers of what pixel centres show, as the shader ``TRUTH`` writes them."""
        target = self._target("truth", camera.width)
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0)
        self.gl.enable_only(moderngl.DEPTH_TEST)
        shared = {
            **shared, "toClip": clip_matrix(camera), "toCameraTurn": np.asarray(camera.rotation),
            "toCameraShift": np.asarray(camera.translation), "faint": 1.0,
        }  # fmt: skip
        for only in (False, True):
            chosen = [k for k, m in enumerate(meshes) if m.true and m.only_label == only]
            everything = (not only,) * 4
            target.color_mask = (everything, everything, (True,) * 4)
            target.depth_mask = not only
            self._draw("truth", [meshes[k] for k in chosen], [loaded[k] for k in chosen], shared)
        target.color_mask = ((True,) * 4,) * 3
        target.depth_mask = True
        shape = (camera.height, camera.width, 4)
        where, facing, part = (
            np.frombuffer(target.read(components=4, attachment=k, dtype="f4"), np.float32).reshape(shape)
            for k in range(3)
        )
        return where, facing, part


def _halved(image: Float) -> Float:
    """Means of two by two pixels; ``mean`` over two axes takes four times as long."""
    rows = image[0::TWICE] + image[1::TWICE]
    return np.asarray((rows[:, 0::TWICE] + rows[:, 1::TWICE]) * np.float32(1 / TWICE**2))


@functools.lru_cache(maxsize=1)
def renderer() -> Renderer:
    """The process's renderer.

    Raises:
        ModelFault: there is no OpenGL through EGL on this machine.
    """
    return Renderer()
