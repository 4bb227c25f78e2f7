"""GLSL of strands: lines that are lit at their points, with their direction and normal beside the light.

Kajiya and Kay 1989 with two shifted lobes (Scheuermann 2004); how much hair light has passed comes with the vertex.
"""

from __future__ import annotations

from typing import Any

STRAND_VERTEX = """
#version 330
uniform mat4 toClip; uniform mat3 toCameraTurn; uniform vec3 toCameraShift; uniform vec3 eye; uniform float gloss;
uniform vec3 lampAt[3]; uniform vec3 lampLight[3]; uniform mat4 toLamp[3]; uniform int lamps;
uniform sampler2D shadow;
in vec3 position; in vec3 tangent; in vec3 outward; in vec3 albedo; in vec4 lit; in vec3 sky;
out vec3 light; out vec4 way; out vec3 normal;
const float LIFT = 0.002, TILT = 0.0524, PI = 3.14159265;
float open(int i, vec3 at) {  // to a lamp: the head and what is worn on it, not the hair close by
  vec4 q4 = toLamp[i] * vec4(at, 1.0);
  vec3 m = q4.xyz / q4.w * 0.5 + 0.5;
  if (m.x < 0.0 || m.x > 1.0 || m.y < 0.0 || m.y > 1.0) return 1.0;
  return step(m.z, texture(shadow, vec2((clamp(m.x, 0.001, 0.999) + float(i)) / 3.0, m.y)).r);
}
void main() {
  vec3 T = normalize(tangent + vec3(0.0, 1e-9, 0.0)), V = normalize(eye - position);
  light = sky * albedo * (0.2 + 0.8 * lit.w);
  for (int i = 0; i < lamps; i++) {
    vec3 to = lampAt[i] - position; float far = dot(to, to); vec3 L = to * inversesqrt(far), H = normalize(L + V);
    float c = dot(T, L), matt = sqrt(max(0.0, 1.0 - c * c)), a = asin(clamp(dot(T, H), -1.0, 1.0));
    float first = 0.12 * pow(max(0.0, cos(clamp(a + 2.0 * TILT, -1.57, 1.57))), 60.0);
    float second = 0.25 * pow(max(0.0, cos(clamp(a - 3.0 * TILT, -1.57, 1.57))), 18.0);
    float faces = 0.3 + 0.7 * clamp(0.6 + 0.6 * dot(outward, L), 0.0, 1.0);
    vec3 e = lampLight[i] / far * lit[i] * open(i, position + 0.02 * L) * faces / PI;
    light += e * (albedo * (0.85 * matt + gloss * second) + gloss * first * 1.3);
  }
  vec3 lifted = position + LIFT * V;
  vec4 here = toClip * vec4(lifted, 1.0), there = toClip * vec4(lifted + 0.001 * T, 1.0);
  vec2 across = there.xy / there.w - here.xy / here.w;
  way = vec4(across / max(length(across), 1e-9), (toCameraTurn * position + toCameraShift).z, 1.0);
  normal = toCameraTurn * normalize(outward - dot(outward, T) * T + 1e-6 * V);
  gl_Position = here;
}
"""
STRAND_FRAGMENT = """
#version 330
in vec3 light; in vec4 way; in vec3 normal;
layout(location = 0) out vec4 result; layout(location = 1) out vec4 run; layout(location = 2) out vec4 facing;
void main() {
  result = vec4(min(light, vec3(1e4)), 1.0);
  run = vec4(normalize(way.xy + 1e-9), way.zw);
  facing = vec4(normalize(normal), 1.0);
}
"""

STRAND_SHADOW_VERTEX = """
#version 330
uniform mat4 toClip; in vec3 position;
void main() { gl_Position = toClip * vec4(position, 1.0); }
"""
STRAND_SHADOW_FRAGMENT = "#version 330\nvoid main() {}\n"


def strand_programs(gl: Any) -> dict[str, Any]:
    """The programs that draw them."""
    return {
        "draw": gl.program(vertex_shader=STRAND_VERTEX, fragment_shader=STRAND_FRAGMENT),
        "cast": gl.program(vertex_shader=STRAND_SHADOW_VERTEX, fragment_shader=STRAND_SHADOW_FRAGMENT),
    }
