// Six expressions as weights of the ARKit blendshapes.

import type { Weights } from "../viewer/motion";

/** The same weight on both sides. */
function both(weights: Weights): Weights {
  return Object.fromEntries(
    Object.entries(weights).flatMap(([name, weight]) => [
      [`${name}Left`, weight],
      [`${name}Right`, weight],
    ]),
  );
}

export const PRESETS: [id: string, title: string, weights: Weights][] = [
  ["neutral", "Neutral", {}],
  ["smile", "Smile", both({ mouthSmile: 0.65, mouthDimple: 0.2, cheekSquint: 0.4, eyeSquint: 0.2 })],
  [
    "laugh",
    "Laugh",
    { jawOpen: 0.4, ...both({ mouthSmile: 0.75, cheekSquint: 0.6, eyeSquint: 0.45, mouthUpperUp: 0.3, mouthLowerDown: 0.2 }) },
  ],
  [
    "surprise",
    "Surprise",
    { jawOpen: 0.45, mouthFunnel: 0.2, browInnerUp: 0.9, ...both({ browOuterUp: 0.8, eyeWide: 0.7 }) },
  ],
  [
    "sadness",
    "Sadness",
    { browInnerUp: 0.85, mouthShrugLower: 0.35, ...both({ mouthFrown: 0.7, eyeLookDown: 0.25, eyeBlink: 0.12 }) },
  ],
  [
    "anger",
    "Anger",
    { mouthShrugLower: 0.2, ...both({ browDown: 0.9, noseSneer: 0.45, mouthPress: 0.5, mouthFrown: 0.35, eyeSquint: 0.35 }) },
  ],
];
