// The team score and what made it change.

import { readInks } from "./colour";
import { make, number } from "./dom";
import { niceStep } from "./scenery";
import type { Session } from "./session";
import { signMark, signOf } from "./signs";
import { Series, type Entry } from "./timeline";

const PAD = { left: 40, right: 10, top: 10, bottom: 20 };

export class Chart {
  private readonly context: CanvasRenderingContext2D;
  private pointer: number | null = null;
  private key = "";
  private legendKey = "";
  private spanX = { from: 0, to: 1 };
  private session: Session | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly legend: HTMLElement,
    seek: (x: number) => void,
  ) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("this browser has no Canvas 2-D");
    this.context = context;
    canvas.addEventListener("pointermove", (event) => this.point(event.offsetX));
    canvas.addEventListener("pointerleave", () => this.point(null));
    canvas.addEventListener("click", (event) => seek(this.toX(event.offsetX)));
  }

  private point(at: number | null): void {
    this.pointer = at;
    if (this.session) this.draw(this.session); // also when nothing else happens
  }

  private toX(px: number): number {
    const width = this.canvas.clientWidth - PAD.left - PAD.right;
    return this.spanX.from + ((px - PAD.left) / width) * (this.spanX.to - this.spanX.from);
  }

  draw(session: Session): void {
    this.session = session;
    const { timeline, state } = session;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!timeline || !state || width < 60) return;
    const ratio = window.devicePixelRatio || 1;
    const theme = document.documentElement.dataset.theme;
    const key = [session.x, timeline.score.x.length, timeline.entries.length, state.bound, this.pointer, width, height, ratio, theme, state.scoreFlown].join();
    if (key === this.key) return;
    this.key = key;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const c = this.context;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    const inks = readInks();
    const style = getComputedStyle(document.documentElement);
    const font = getComputedStyle(document.body).fontFamily;
    const { replay } = session;
    const from = replay?.start ?? timeline.score.x[0] ?? 0;
    const to = Math.max(replay?.end ?? session.x, from + 1e-9);
    this.spanX = { from, to };
    const [low, high] = range(timeline.score, timeline.flown, state.bound);
    const [w, h] = [width - PAD.left - PAD.right, height - PAD.top - PAD.bottom];
    const px = (x: number): number => PAD.left + ((x - from) / (to - from)) * w;
    const py = (y: number): number => PAD.top + h - ((y - low) / (high - low)) * h;

    c.font = `11px ${font}`;
    c.textBaseline = "middle";
    c.textAlign = "right";
    const step = niceStep(h / (high - low), 30);
    for (let k = Math.ceil(low / step); k * step <= high; k++) {
      c.fillStyle = style.getPropertyValue("--line");
      c.fillRect(PAD.left, Math.round(py(k * step)), w, 1);
      c.fillStyle = inks.faint;
      c.fillText(number(k * step, step < 1 ? 1 : 0), PAD.left - 6, py(k * step));
    }
    c.textBaseline = "top";
    c.textAlign = "left";
    const unit = timeline.byEvents ? "" : " s";
    const steps = niceStep(w / (to - from), 70);
    for (let k = Math.ceil(from / steps); k * steps <= to; k++) {
      const text = `${number(k * steps, steps < 1 ? 1 : 0)}${unit}`;
      const place = px(k * steps);
      c.textAlign = place > width - 30 ? "right" : k === 0 ? "left" : "center";
      c.fillText(text, place, height - PAD.bottom + 6);
    }

    if (Number.isFinite(state.bound)) {
      c.setLineDash([6, 4]);
      line(c, inks.ink, 1.3, () => {
        c.moveTo(PAD.left, py(state.bound));
        c.lineTo(PAD.left + w, py(state.bound));
      });
      c.setLineDash([]);
    }
    const now = timeline.score.at(session.x);
    if (replay) this.curve(timeline.score, timeline.score.x.length - 1, px, py, style.getPropertyValue("--line"), 2, to);
    if (timeline.flown.x.length) this.curve(timeline.flown, timeline.flown.at(session.x), px, py, inks.faint, 1.2, -Infinity);
    this.curve(timeline.score, now, px, py, inks.accent, 2, session.x);
    this.marks(timeline.entries, timeline.entriesUpTo(session.x), px, py, style);
    if (replay) line(c, inks.ink, 1, () => {
      c.moveTo(px(session.x), PAD.top);
      c.lineTo(px(session.x), PAD.top + h);
    });
    if (this.pointer !== null) this.readOut(session, px, py, inks.ink, inks.paper, width);
    this.drawLegend(session);
  }

  private curve(series: Series, last: number, px: (x: number) => number, py: (y: number) => number, colour: string, width: number, until: number): void {
    if (last < 0) return;
    const c = this.context;
    line(c, colour, width, () => {
      c.moveTo(px(series.x[0]), py(series.y[0]));
      for (let i = 1; i <= last; i++) {
        if (until !== -Infinity) c.lineTo(px(series.x[i]), py(series.y[i - 1])); // the score stays until it changes
        c.lineTo(px(series.x[i]), py(series.y[i]));
      }
      if (until > series.x[last]) c.lineTo(px(until), py(series.y[last]));
    });
  }

  private marks(entries: Entry[], count: number, px: (x: number) => number, py: (y: number) => number, style: CSSStyleDeclaration): void {
    const c = this.context;
    const taken = new Map<string, number>();
    for (let i = 0; i < count; i++) {
      const entry = entries[i];
      if (!Number.isFinite(entry.score) || entry.kind === "initial") continue;
      const sign = signOf(entry.kind);
      const x = px(entry.x);
      if (!sign.rare && x - (taken.get(entry.kind) ?? -Infinity) < 9) continue;
      taken.set(entry.kind, x);
      c.save();
      c.translate(x, py(entry.score));
      c.scale(0.85, 0.85);
      const path = new Path2D(sign.path);
      c.lineWidth = sign.filled ? 1.5 : 4;
      c.strokeStyle = style.getPropertyValue("--panel");
      c.stroke(path);
      c.strokeStyle = c.fillStyle = style.getPropertyValue(sign.colour);
      c.lineWidth = 1.9;
      if (sign.filled) c.fill(path);
      else c.stroke(path);
      c.restore();
    }
  }

  private readOut(session: Session, px: (x: number) => number, py: (y: number) => number, ink: string, paper: string, width: number): void {
    const { timeline } = session;
    if (!timeline || this.pointer === null) return;
    const i = timeline.score.at(this.toX(this.pointer));
    if (i < 0) return;
    const [x, y] = [timeline.score.x[i], timeline.score.y[i]];
    const entry = timeline.entries[timeline.entriesUpTo(x) - 1];
    const what = entry && Math.abs(entry.x - x) < 1e-9 ? ` · ${signOf(entry.kind).label}` : "";
    const text = `${number(y, 2)}${what}`;
    const c = this.context;
    c.beginPath();
    c.arc(px(x), py(y), 4, 0, 2 * Math.PI);
    c.fillStyle = ink;
    c.fill();
    const w = c.measureText(text).width + 12;
    const left = Math.min(Math.max(px(x) - w / 2, 2), width - w - 2);
    const top = py(y) > 44 ? py(y) - 30 : py(y) + 12;
    c.fillRect(left, top, w, 20);
    c.fillStyle = paper;
    c.textAlign = "left";
    c.textBaseline = "middle";
    c.fillText(text, left + 6, top + 10.5);
  }

  private drawLegend(session: Session): void {
    const kinds = new Set<string>();
    for (const entry of session.timeline?.entries ?? []) if (Number.isFinite(entry.score) && entry.kind !== "initial") kinds.add(entry.kind);
    if (session.timeline?.flown.x.length) kinds.add("flown");
    if (Number.isFinite(session.state?.bound ?? NaN)) kinds.add("bound");
    const key = [...kinds].join();
    if (key === this.legendKey) return;
    this.legendKey = key;
    this.legend.replaceChildren(...[...kinds].map((kind) => make("li", {}, signMark(kind), signOf(kind).label)));
  }
}

function line(context: CanvasRenderingContext2D, colour: string, width: number, path: () => void): void {
  context.beginPath();
  path();
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.lineJoin = "round";
  context.stroke();
}

function range(score: Series, flown: Series, bound: number): [number, number] {
  let [low, high] = [Infinity, Number.isFinite(bound) ? bound : -Infinity];
  for (const series of [score, flown]) {
    for (const y of series.y) {
      if (y < low) low = y;
      if (y > high) high = y;
    }
  }
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  const pad = 0.06 * Math.max(high - low, 0.05 * Math.abs(high), 1e-6);
  return [Math.max(low - pad, low >= 0 ? 0 : -Infinity), high + pad];
}
