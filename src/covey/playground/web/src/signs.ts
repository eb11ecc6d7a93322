// The signs of events, the same on the score curve, in the log and on the scrub bar: told apart by shape, not only by colour.

import { svg } from "./dom";

export interface Sign {
  label: string;
  path: string;
  /** Name of a colour of the style sheet. */
  colour: string;
  filled: boolean;
  /** Drawn even where there is no room. */
  rare: boolean;
}

const CIRCLE = "M-3.6 0a3.6 3.6 0 1 0 7.2 0a3.6 3.6 0 1 0-7.2 0z";
const UP = "M0-4 4 3.4-4 3.4z";
const DOWN = "M0 4 4-3.4-4-3.4z";
const DIAMOND = "M0-4.6 4.6 0 0 4.6-4.6 0z";
const CROSS = "M-3.6-3.6 3.6 3.6M-3.6 3.6 3.6-3.6";
const PLUS = "M-4.4 0H4.4M0-4.4V4.4";
const SQUARE = "M-3.4-3.4H3.4V3.4H-3.4z";
const DOT = "M-2 0a2 2 0 1 0 4 0a2 2 0 1 0-4 0z";

const SIGNS: Record<string, Sign> = {
  trade: { label: "trade", path: CIRCLE, colour: "--accent", filled: true, rare: false },
  optimization: { label: "optimisation", path: UP, colour: "--faint", filled: true, rare: false },
  proof: { label: "better pose proved", path: UP, colour: "--good", filled: false, rare: false },
  adoption: { label: "adoption", path: DIAMOND, colour: "--good", filled: true, rare: true },
  death: { label: "death", path: CROSS, colour: "--bad", filled: false, rare: true },
  return: { label: "return", path: PLUS, colour: "--good", filled: false, rare: true },
  joined: { label: "joined", path: PLUS, colour: "--accent", filled: false, rare: true },
  left: { label: "left", path: CROSS, colour: "--warn", filled: false, rare: true },
  abandoned: { label: "waypoint given up", path: DOWN, colour: "--warn", filled: true, rare: true },
  landmarks: { label: "landmarks changed", path: SQUARE, colour: "--warn", filled: false, rare: true },
  collision: { label: "collision", path: CROSS, colour: "--bad", filled: false, rare: true },
  fault: { label: "fault", path: CROSS, colour: "--bad", filled: false, rare: true },
  flown: { label: "as flown", path: "M-6 3-2-2 2 2 6-3", colour: "--faint", filled: false, rare: true },
  bound: { label: "bound", path: "M-7 0H-3M-1 0H3M5 0H7", colour: "--ink", filled: false, rare: true },
  ended: { label: "the end", path: SQUARE, colour: "--ink", filled: true, rare: true },
};

const OTHER: Sign = { label: "", path: DOT, colour: "--faint", filled: true, rare: false };

export function signOf(kind: string): Sign {
  return Object.hasOwn(SIGNS, kind) ? SIGNS[kind] : { ...OTHER, label: kind };
}

export function signMark(kind: string): SVGSVGElement {
  const sign = signOf(kind);
  const mark = svg(sign.path, "-7 -6 14 12");
  const line = mark.firstElementChild as SVGPathElement;
  line.style.stroke = `var(${sign.colour})`;
  line.style.fill = sign.filled ? `var(${sign.colour})` : "none";
  line.style.strokeWidth = sign.filled ? "0" : "1.9";
  return mark;
}
