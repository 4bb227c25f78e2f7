"""GLSL of the portraits: one vertex shader, and three fragment shaders (radiance, truth, depth for shadows).

Positions, normals and light are in head space; ``toCamera`` maps to x right, y down, z forward.
"""

from __future__ import annotations

KINDS = {
    "skin": 0, "eye": 1, "mouth": 2, "hair": 3, "cloth": 4, "plain": 5, "lens": 6, "fur": 7, "brow": 8, "lash": 9,
    "knit": 10,
}  # fmt: skip
"""Materials; the shaders branch on these numbers."""

MOST_LAMPS = 3

VERTEX = """
#version 330
uniform mat4 toClip; uniform vec3 eye; uniform float lift;  // lift: metres towards the camera
in vec3 position; in vec3 normal; in vec4 uv; in vec4 ambient; in vec2 chart;
out vec3 p; out vec3 n; out vec4 t; out vec4 a; out vec2 q;
void main() {
  p = position; n = normal; t = uv; a = ambient; q = chart;
  gl_Position = toClip * vec4(position + lift * normalize(eye - position), 1.0);
}
"""

_COMMON = """
#version 330
in vec3 p; in vec3 n; in vec4 t; in vec4 a; in vec2 q;
const int kind = KIND;
const float BLUR = SOFTNESS;  // level of detail by which strands are evened out
uniform sampler2D picture;   // sRGB albedo, or grey and alpha of cards
uniform sampler2D layers;    // lips, brow, stubble, scalp
uniform sampler2D strands;   // beard strands of four lengths
uniform sampler2D places;    // beard, moustache
uniform vec4 beard;          // density of beard, of moustache; length 0..3; edge
uniform vec3 eye;            // camera, head space
uniform float limbus;        // polar angle, radians
uniform float cutoff;        // alpha below which a card is not there
uniform float faint;         // share of it below which brows and lashes are not drawn
uniform float level;         // of fur: 0 skin to 1 tips

float hash(vec2 x) { return fract(sin(dot(x, vec2(127.1, 311.7))) * 43758.5453); }
float blob(vec2 x) {         // smooth noise in [0, 1]
  vec2 i = floor(x), f = fract(x); f = f * f * (3.0 - 2.0 * f);
  return mix(mix(hash(i), hash(i + vec2(1, 0)), f.x), mix(hash(i + vec2(0, 1)), hash(i + vec2(1, 1)), f.x), f.y);
}
float bearded() {            // cover by strands at this point of the skin
  vec2 place = texture(places, t.xy).xy;
  float where = clamp(beard.x * place.x + beard.y * place.y, 0.0, 1.2);
  where = smoothstep(beard.w, beard.w + 0.35, where + 0.25 * (blob(t.xy * 90.0) - 0.5)) * step(0.001, where);
  vec4 s = texture(strands, t.xy, BLUR);
  vec4 w = max(vec4(0.0), 1.0 - abs(vec4(0, 1, 2, 3) - beard.z));
  return where * min(1.0, dot(s, w) * max(beard.x, beard.y) * 1.3);
}
bool holed() {               // whether a card or fur is not there
  if (kind == 3) return texture(picture, t.xy).a < cutoff;
  if (kind == 8 || kind == 9) return texture(picture, t.xy).r < cutoff * faint;
  if (kind == 10) return t.z < -0.001;
  if (kind == 4) return t.z < -0.001 || texture(picture, t.xy).a < 0.5;
  if (kind == 7) {
    vec2 place = texture(places, t.xy).xy;
    float where = t.z > 0.5 ? t.w : smoothstep(beard.w, beard.w + 0.5, beard.x * place.x + beard.y * place.y);
    float strand = blob(t.xy * vec2(600.0, 400.0)) * 0.7 + 0.3 * blob(t.xy * vec2(200.0, 140.0));
    return where * (1.15 - level) < 0.25 + 0.75 * strand;
  }
  return false;
}
"""

RADIANCE = (
    _COMMON
    + """
uniform vec3 colour;         // of hair, frames, cloth; linear
uniform vec3 scalp;          // colour of hair painted on the scalp
uniform vec4 tone;           // multiplies skin albedo; w: share of wear in cloth pictures
uniform vec4 gloss;          // alpha narrow, broad, share of the narrow one, F0 scale
uniform vec3 lampAt[3]; uniform vec3 lampLight[3]; uniform mat4 toLamp[3]; uniform float lampSize[3];
uniform int lamps;
uniform sampler2D shadow;    // depth maps of all lamps side by side
uniform sampler2D gobo; uniform float goboShare;
uniform sampler2D sky;       // latitude-longitude, linear, with mip levels
uniform float transmission;  // of lenses
uniform sampler2D iris; uniform vec4 eyeLook;  // pupil scale, redness, brightness
uniform sampler2D made;      // places of make-up: upper lids, edges of the lids, cheeks, brows
uniform vec4 lipPaint; uniform vec4 lidPaint;  // linear RGB and strength
uniform vec4 facePaint;      // line round the eyes, rouge, plucked brows, foundation
uniform vec4 knit;           // of wool and felt: ribs around, rows a metre, how deep, stripes a metre
uniform vec2 band;           // heights between which there is a ribbon
uniform vec3 stripe;         // colour of ribbon and stripes
uniform float graininess;
out vec4 result;

const float PI = 3.14159265;
const vec2 disc[5] = vec2[5](
  vec2(0.1, -0.25), vec2(-0.55, 0.05), vec2(0.35, 0.6), vec2(0.75, -0.35), vec2(-0.45, -0.85));
vec3 linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
vec3 seenSky(vec3 d, float lod) {
  vec2 at = vec2(atan(d.x, d.z) / (2.0 * PI) + 0.5, acos(clamp(d.y, -1.0, 1.0)) / PI);
  return textureLod(sky, at, lod).rgb;
}
float shadowOf(int i, vec3 at) {
  vec4 q4 = toLamp[i] * vec4(at, 1.0);
  vec3 m = q4.xyz / q4.w * 0.5 + 0.5;
  if (m.x < 0.0 || m.x > 1.0 || m.y < 0.0 || m.y > 1.0) return 1.0;
  float open = 0.0, turn = 6.2832 * hash(gl_FragCoord.xy);
  float c = cos(turn), s = sin(turn);
  for (int k = 0; k < 5; k++) {
    vec2 o = disc[k] * lampSize[i];
    vec2 at2 = clamp(m.xy + vec2(c * o.x - s * o.y, s * o.x + c * o.y), 0.001, 0.999);
    open += step(m.z, texture(shadow, vec2((at2.x + float(i)) / 3.0, at2.y)).r);
  }
  open *= 0.2;
  if (i == 0) open *= mix(1.0, texture(gobo, m.xy).r, goboShare);
  return open;
}
float ggx(float nh, float alpha) {
  float q = alpha * alpha, d = nh * nh * (q - 1.0) + 1.0;
  return q / (PI * d * d);
}
float lobe(vec3 N, vec3 V, vec3 L, float alpha, float f0) {
  vec3 H = normalize(V + L);
  float k = alpha * 0.5, nl = max(dot(N, L), 0.0), nv = max(dot(N, V), 1e-3);
  float g = 1.0 / mix(nv, 1.0, k) / mix(max(nl, 1e-3), 1.0, k);
  float f = f0 + (1.0 - f0) * pow(clamp(1.0 - dot(V, H), 0.0, 1.0), 5.0);
  return ggx(max(dot(N, H), 0.0), alpha) * g * f * 0.25 * nl;
}
void main() {
  if (holed()) discard;
  vec3 V = normalize(eye - p), N = normalize(n + vec3(0.0, 0.0, 1e-9));
  if (kind > 2 && kind != 7 && dot(N, V) < 0.0) N = -N;
  vec3 albedo = colour; vec3 wrap = vec3(0.0); vec4 shine = gloss;
  vec3 S = N;                // normal of the reflection
  float wet = 1.0;
  if (kind == 0) {
    vec4 over = texture(layers, t.xy);
    albedo = linear(texture(picture, t.xy).rgb) * tone.rgb;
    vec4 paint = texture(made, t.xy);
    vec3 even = linear(texture(picture, t.xy, 5.0).rgb) * tone.rgb;
    albedo = mix(albedo, even, max(facePaint.w * (1.0 - max(over.r, over.g)), facePaint.z * over.g * paint.a));
    albedo *= mix(vec3(1.0), vec3(1.05, 0.7, 0.72), facePaint.y * paint.b);
    albedo = mix(albedo, lidPaint.rgb, lidPaint.a * paint.r);
    albedo *= 1.0 - 0.9 * facePaint.x * smoothstep(0.05, 0.4, paint.g);
    albedo = mix(albedo, lipPaint.rgb * (0.5 + albedo / max(max(albedo.r, albedo.g), 1e-3) * 0.5), lipPaint.a * over.r);
    albedo = mix(albedo, albedo * vec3(0.8, 0.3, 0.26) + vec3(0.03, 0.0, 0.0), t.z);   // mouth lining and socket
    float roots = max(over.a, -t.w);   // hair painted on the scalp; t.w < 0: of a groom's roots
    albedo = mix(albedo, scalp * (0.75 + 0.5 * blob(t.xy * 300.0)), roots * 0.85);
    float b = bearded() * (1.0 - t.z);
    albedo = mix(albedo, colour, b);
    wrap = vec3(0.30, 0.12, 0.07) * (1.0 - 0.8 * b);
    shine.w *= 1.0 - 0.7 * max(b, max(over.g, roots));
    shine.x = mix(shine.x, 0.2, over.r * 0.6);
    float fine = 0.08 * graininess;
    S = normalize(N + fine * (vec3(blob(t.xy * 700.0), blob(t.xy * 700.0 + 31.0), blob(t.xy * 700.0 + 57.0)) - 0.5));
  } else if (kind == 1) {
    vec3 d = normalize(t.xyz);
    float away = acos(clamp(d.z, -1.0, 1.0));
    vec2 flat_ = normalize(d.xy + 1e-6) * away / limbus;
    float r = length(flat_), pupil = eyeLook.x;
    float stretched = r < pupil ? r / pupil * 0.33 : 0.33 + (r - pupil) / (1.0 - pupil) * 0.67;
    vec3 inner = linear(texture(iris, 0.5 + 0.5 * vec2(flat_.x, -flat_.y) / max(r, 1e-4) * stretched).rgb);
    inner *= smoothstep(pupil * 0.85, pupil * 1.05, r) * (1.0 - 0.55 * smoothstep(0.8, 1.0, r));
    vec3 white = vec3(0.72, 0.66, 0.61) * eyeLook.z;
    float red = eyeLook.y * smoothstep(0.9, 2.3, r) * (0.5 + blob(d.xy * 25.0));
    white = mix(white, white * vec3(1.0, 0.55, 0.5), red);
    albedo = mix(inner * 1.2, white, smoothstep(0.93, 1.05, r));
    wrap = vec3(0.15, 0.1, 0.1);
    shine = vec4(0.06, 0.12, 0.8, 1.0);
  } else if (kind == 2) {
    albedo = t.z > 0.5 ? linear(texture(picture, t.xy).rgb) * tone.rgb : colour;
    wrap = vec3(0.2, 0.1, 0.08); shine = vec4(0.14, 0.3, 0.6, 1.0); wet = 0.7;
  } else if (kind == 3) {
    float grey = texture(picture, t.xy).r;
    albedo = colour * mix(0.35, 1.7, grey);
    wrap = vec3(0.25); shine = vec4(0.3, 0.5, 0.5, 0.6);
  } else if (kind == 4) {
    vec3 worn = linear(texture(picture, t.xy).rgb);
    albedo = mix(colour, worn, tone.w) * tone.rgb; shine = vec4(0.6, 0.8, 0.5, 0.3);
  } else if (kind == 10) {
    float rib = 0.5 + 0.5 * cos(6.2832 * t.x * knit.x), row = 0.5 + 0.5 * cos(6.2832 * t.y * knit.y + 3.0 * rib);
    float yarn = mix(rib, rib * row, 0.5) * (0.8 + 0.4 * blob(t.xy * vec2(2.0 * knit.x, knit.y)));
    bool other = (t.y > band.x && t.y < band.y) || (knit.w > 0.0 && fract(t.y * knit.w) < 0.4);
    albedo = (other ? stripe : colour) * mix(1.0, 0.45 + 0.75 * yarn, knit.z);
    albedo *= 0.9 + 0.2 * blob(t.xy * vec2(300.0, 800.0));
    wrap = vec3(0.15); shine = vec4(0.6, 0.8, 0.5, 0.2);
  } else if (kind == 7) {
    albedo = colour * mix(0.45, 1.3, level) * (0.7 + 0.6 * blob(t.xy * 500.0));
    wrap = vec3(0.25); shine = vec4(0.4, 0.6, 0.5, 0.4);
  } else if (kind == 8 || kind == 9) { shine.w = 0.0; }
  vec3 light = a.rgb * albedo;
  float f0 = 0.04 * shine.w, nv = max(dot(S, V), 0.0);
  if (kind == 3 || kind == 7) f0 = 0.03;
  vec3 glints = vec3(0.0);
  vec3 T = vec3(0.0);
  if (kind == 3) {           // along the strands: where the picture's column stays the same
    T = dFdx(p) * dFdy(t.x) - dFdy(p) * dFdx(t.x);
    float size = length(T);
    T = size > 1e-12 ? T / size : vec3(0.0, 1.0, 0.0);
  }
  for (int i = 0; i < lamps; i++) {
    vec3 way = lampAt[i] - p; float far = dot(way, way); vec3 L = way * inversesqrt(far);
    float open = shadowOf(i, p + N * 0.0025);
    vec3 e = lampLight[i] / far * open;
    vec3 soft = max(vec3(0.0), (dot(N, L) + wrap) / ((1.0 + wrap) * (1.0 + wrap)));
    light += e * soft * albedo / PI;
    if (kind == 3) {
      float along = dot(T, normalize(L + V));
      float sheen = 0.10 * pow(max(0.0, 1.0 - along * along), 25.0) * max(0.0, dot(N, L) * 0.7 + 0.3);
      glints += e * sheen * (0.03 + colour);
    } else if (shine.w > 0.0) {
      float s = shine.z * lobe(S, V, L, shine.x, f0) + (1.0 - shine.z) * lobe(S, V, L, shine.y, f0);
      glints += e * s;
    }
  }
  if (shine.w > 0.0) {
    vec3 R = reflect(-V, S);
    float f = f0 + (max(1.0 - shine.y, f0) - f0) * pow(clamp(1.0 - nv, 0.0, 1.0), 5.0);
    float open = min(a.w * a.w * 1.2, 1.0) * (kind == 1 ? 1.0 : 0.22);
    glints += seenSky(R, clamp(6.0 * sqrt(shine.x), 0.0, 6.0)) * f * open;
  }
  light += glints * wet;
  float opaque = 1.0;
  if (kind == 6) {
    vec3 R = reflect(-V, N);
    float f = tone.w + (1.0 - tone.w) * pow(clamp(1.0 - dot(N, V), 0.0, 1.0), 5.0);
    light = seenSky(R, 0.5) * f * tone.rgb;
    for (int i = 0; i < lamps; i++) {
      vec3 L = normalize(lampAt[i] - p);
      vec3 e = lampLight[i] / dot(lampAt[i] - p, lampAt[i] - p);
      light += e * f * 4.0 * smoothstep(0.996, 0.9985, dot(R, L)) * tone.rgb;
    }
    opaque = 1.0 - transmission * (1.0 - f);
  }
  if (kind == 8 || kind == 9) { opaque = texture(picture, t.xy).r; light *= opaque; }
  result = vec4(min(light, vec3(1e4)), opaque);
}
"""
)

TRUTH = (
    _COMMON
    + """
uniform mat3 toCameraTurn; uniform vec3 toCameraShift;
uniform int label; uniform float charted;  // part, and whether chart coordinates are given
uniform sampler2D sky; uniform float glare; uniform float transmission; uniform vec4 tone;
layout(location = 0) out vec4 where;       // u, v, depth, 1 where charted
layout(location = 1) out vec4 facing;      // normal in camera space; 1
layout(location = 2) out vec4 part;        // label
void main() {
  if (holed()) discard;
  vec3 V = normalize(eye - p), N = normalize(n);
  int l = label; float c = charted;
  if (kind == 0) {
    vec4 over = texture(layers, t.xy, BLUR);
    if (t.z > 0.5) l = t.w > 0.5 ? 5 : 1;
    else if (max(bearded(), over.b) > 0.2) l = 3;
    else if (over.r > 0.5) l = 4;
    else if (over.g > 0.25) l = 2;
    else if (max(over.a, -t.w) > 0.6 && t.z < 0.5) l = 8;
  } else if (kind == 1) {
    vec3 d = normalize(t.xyz);
    l = acos(clamp(d.z, -1.0, 1.0)) < limbus ? 7 : 6;
  } else if (kind == 6) {
    vec3 R = reflect(-V, dot(N, V) < 0.0 ? -N : N);
    vec2 at = vec2(atan(R.x, R.z) / 6.2831853 + 0.5, acos(clamp(R.y, -1.0, 1.0)) / 3.14159265);
    float f = tone.w + (1.0 - tone.w) * pow(clamp(1.0 - abs(dot(N, V)), 0.0, 1.0), 5.0);
    float bright = dot(textureLod(sky, at, 0.5).rgb, vec3(0.3333)) * f;
    if (transmission > 0.35 && bright < glare) discard;
  }
  if (dot(N, V) < 0.0 && kind != 0 && kind != 1) N = -N;
  where = vec4(q, (toCameraTurn * p + toCameraShift).z, c);
  facing = vec4(toCameraTurn * N, 1.0);
  part = vec4(float(l));
}
"""
)

SHADOW = _COMMON + "void main() { if (holed()) discard; }\n"
