// Surfaces of the head: lit by the maps, or one map as it is.

import {
  Color,
  MeshBasicMaterial,
  MeshPhysicalMaterial,
  MeshStandardMaterial,
  ObjectSpaceNormalMap,
  ShaderChunk,
  TangentSpaceNormalMap,
  Texture,
  Vector2,
  type WebGLProgramParametersWithUniforms,
} from "three";

export interface Surface {
  colour: Texture | null;
  specular: Texture | null;
  normal: Texture | null;
  normalCoding: Vector2;
  objectSpace: boolean;
  diffuseNormal: Texture | null;
}

export const PLAIN: Surface = {
  colour: null,
  specular: null,
  normal: null,
  normalCoding: new Vector2(0.5, 0.5),
  objectSpace: false,
  diffuseNormal: null,
};

const CLAY = new Color(0.5, 0.48, 0.46);

/**
 * Lit surface. With both normal maps the gloss follows the specular normals and the diffuse light the diffuse ones
 * (hybrid normals, Ma et al. 2007); three.js knows one normal, so the shader gets a second.
 */
export class Skin extends MeshPhysicalMaterial {
  private readonly shared = {
    normalCoding: { value: new Vector2() },
    diffuseNormalMap: { value: null as Texture | null },
  };

  constructor(from: MeshStandardMaterial) {
    super({
      name: from.name,
      color: from.color,
      roughness: from.roughness,
      metalness: 0,
      transparent: from.transparent,
      opacity: from.opacity,
      side: from.side,
      depthWrite: !from.transparent,
      // The loader's: +Y as it is on a mesh with tangents, turned over where three.js makes them from v, which grows down.
      normalScale: from.normalScale,
    });
    this.userData.colour = from.color.clone();
  }

  wear(surface: Surface): void {
    this.map = surface.colour;
    this.color.copy(surface.colour ? (this.userData.colour as Color) : CLAY);
    this.specularColorMap = surface.specular;
    this.normalMap = surface.normal;
    this.normalMapType = surface.objectSpace ? ObjectSpaceNormalMap : TangentSpaceNormalMap;
    this.shared.normalCoding.value.copy(surface.normalCoding);
    this.shared.diffuseNormalMap.value = surface.diffuseNormal;
    this.needsUpdate = true;
  }

  override onBeforeCompile(shader: WebGLProgramParametersWithUniforms): void {
    Object.assign(shader.uniforms, this.shared);
    const hybrid = this.shared.diffuseNormalMap.value !== null && this.normalMap !== null;
    shader.fragmentShader = replaced(shader.fragmentShader, {
      "#include <normal_fragment_maps>": normals(hybrid, this.normalMapType === ObjectSpaceNormalMap),
      "#include <lights_physical_pars_fragment>": `
        uniform vec2 normalCoding;
        uniform sampler2D diffuseNormalMap;
        vec3 diffuseNormal;
        ${replaced(ShaderChunk.lights_physical_pars_fragment, {
          "reflectedLight.directDiffuse += irradiance *":
            "reflectedLight.directDiffuse += saturate( dot( diffuseNormal, directLight.direction ) ) * directLight.color *",
        })}`,
      "#include <lights_fragment_maps>": replaced(ShaderChunk.lights_fragment_maps, {
        "iblIrradiance += getIBLIrradiance( geometryNormal )": "iblIrradiance += getIBLIrradiance( diffuseNormal )",
      }),
    });
  }

  override customProgramCacheKey(): string {
    return `skin ${this.shared.diffuseNormalMap.value !== null} ${this.normalMap !== null} ${this.normalMapType}`;
  }
}

function normals(hybrid: boolean, objectSpace: boolean): string {
  const coded = "texture2D( normalMap, vNormalMapUv ).xyz * 2.0 - 1.0";
  const decoded = "( texture2D( normalMap, vNormalMapUv ).xyz - normalCoding.x ) / normalCoding.y";
  const chunk = ShaderChunk.normal_fragment_maps.replaceAll(coded, decoded);
  if (chunk.includes(coded) || !chunk.includes(decoded)) throw new Error("three.js decodes normal maps differently now");
  if (!hybrid) return `${chunk}\ndiffuseNormal = normal;`;
  const second = decoded.replace("normalMap,", "diffuseNormalMap,");
  const turned = objectSpace
    ? `normalize( normalMatrix * ( ${second} ) )`
    : `normalize( tbn * ( ( ${second} ) * vec3( normalScale, 1.0 ) ) )`;
  return `${chunk}\ndiffuseNormal = ${turned};`;
}

const SEEN = new Color("#2f8a63");
const MIRRORED = new Color("#4a78c8");
const MADE_UP = new Color("#c9c6be");

/** One map as it is, without light; confidence in three colours. */
export class MapSurface extends MeshBasicMaterial {
  private readonly confidence: boolean;

  constructor(texture: Texture, role: string) {
    super({ map: texture, toneMapped: false });
    this.confidence = role === "confidence";
  }

  override onBeforeCompile(shader: WebGLProgramParametersWithUniforms): void {
    if (!this.confidence) return;
    Object.assign(shader.uniforms, {
      seen: { value: SEEN },
      mirrored: { value: MIRRORED },
      madeUp: { value: MADE_UP },
    });
    shader.fragmentShader =
      "uniform vec3 seen, mirrored, madeUp;\n" +
      replaced(shader.fragmentShader, {
        "#include <map_fragment>": `
          float code = floor( texture2D( map, vMapUv ).r * 255.0 + 0.5 );
          diffuseColor.rgb = code > 127.5 ? mix( madeUp, seen, 0.35 + 0.65 * ( code - 128.0 ) / 127.0 )
            : code > 0.5 ? mix( madeUp, mirrored, 0.35 + 0.65 * ( code - 1.0 ) / 126.0 ) : madeUp;`,
      });
  }

  override customProgramCacheKey(): string {
    return `map ${this.confidence}`;
  }
}

function replaced(text: string, parts: Record<string, string>): string {
  for (const [old, fresh] of Object.entries(parts)) {
    if (!text.includes(old)) throw new Error(`the shader of three.js has no "${old}" any more`);
    text = text.replace(old, () => fresh);
  }
  return text;
}
