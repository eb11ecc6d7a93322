// Colours: of agents, of the heat map, and those of the page that canvases need.

export interface Rgb {
  r: number;
  g: number;
  b: number;
}

export function parse(colour: string): Rgb {
  const value = Number.parseInt(colour.slice(1), 16);
  return { r: (value >> 16) & 255, g: (value >> 8) & 255, b: value & 255 };
}

function luminance({ r, g, b }: Rgb): number {
  const linear = [r, g, b].map((v) => (v <= 10 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
}

/** Ink or white, whichever reads better on a colour. */
export function inkOn(colour: string): string {
  const l = luminance(parse(colour));
  return 1.05 / (l + 0.05) > (l + 0.05) / (0.0103 + 0.05) ? "#ffffff" : "#1a1a1a";
}

export function withAlpha(colour: string, alpha: number): string {
  const { r, g, b } = parse(colour);
  return `rgba(${r},${g},${b},${alpha})`;
}

/** An opaque pixel of an ImageData, as it lies in memory. */
export function pixel({ r, g, b }: Rgb, alpha = 255): number {
  return ((alpha << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

// Cividis, after Nunez, Anderton and Renslow (2018): even for people with any colour vision.
const CIVIDIS = ["#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838"].map(parse);

/** Colour of a visibility from 0 to 1. */
export function heat(value: number): Rgb {
  const place = Math.min(Math.max(value, 0), 1) * (CIVIDIS.length - 1);
  const i = Math.min(Math.floor(place), CIVIDIS.length - 2);
  const f = place - i;
  const [a, b] = [CIVIDIS[i], CIVIDIS[i + 1]];
  const mix = (u: number, v: number): number => Math.round(u + (v - u) * f);
  return { r: mix(a.r, b.r), g: mix(a.g, b.g), b: mix(a.b, b.b) };
}

export function css({ r, g, b }: Rgb): string {
  return `rgb(${r},${g},${b})`;
}

/** The colours of the page as its style sheet has them. */
export interface Inks {
  paper: string;
  ink: string;
  faint: string;
  line: string;
  accent: string;
  unowned: string;
}

export function readInks(): Inks {
  const style = getComputedStyle(document.documentElement);
  const get = (name: string): string => style.getPropertyValue(name).trim();
  return {
    paper: get("--paper"),
    ink: get("--ink"),
    faint: get("--faint"),
    line: get("--grid"),
    accent: get("--accent"),
    unowned: get("--unowned"),
  };
}
