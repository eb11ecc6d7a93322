// What changes seldom and lies over the landmarks: regions, obstacles, the paths flown, and the axes in metres.

import { withAlpha, type Inks } from "./colour";
import type { Obstacle, State, World } from "./state";
import { lastAtOrBefore, type Path } from "./timeline";
import type { View } from "./view";

function trace(path: CanvasRenderingContext2D, view: View, rings: Float64Array[]): void {
  path.beginPath();
  for (const ring of rings) {
    for (let i = 0; i + 1 < ring.length; i += 2) {
      const [x, y] = [view.x(ring[i]), view.y(ring[i + 1])];
      if (i === 0) path.moveTo(x, y);
      else path.lineTo(x, y);
    }
    path.closePath();
  }
}

let hatching: { ink: string; pattern: CanvasPattern | null } | null = null;

function hatch(context: CanvasRenderingContext2D, ink: string): CanvasPattern | string {
  if (hatching?.ink !== ink) {
    const tile = new OffscreenCanvas(8, 8);
    const draw = tile.getContext("2d");
    if (draw) {
      draw.strokeStyle = ink;
      draw.lineWidth = 1.2;
      draw.beginPath();
      for (const shift of [-8, 0, 8]) {
        draw.moveTo(shift - 1, 9);
        draw.lineTo(shift + 9, -1);
      }
      draw.stroke();
    }
    hatching = { ink, pattern: context.createPattern(tile, "repeat") };
  }
  return hatching.pattern ?? ink;
}

export function drawRegions(context: CanvasRenderingContext2D, view: View, world: World, inks: Inks, selected: number): void {
  if (world.region.length > 1) {
    trace(context, view, world.region.slice(1));
    context.fillStyle = hatch(context, inks.faint);
    context.fill("evenodd");
  }
  trace(context, view, world.region);
  context.strokeStyle = inks.ink;
  context.lineWidth = 1.4;
  context.stroke();
  world.regions.forEach((region, agent) => {
    if (sameRings(region, world.region)) return;
    trace(context, view, region);
    context.setLineDash([]);
    context.strokeStyle = inks.paper;
    context.lineWidth = agent === selected ? 5 : 3.6;
    context.stroke();
    context.setLineDash([7, 4]);
    context.strokeStyle = world.colours[agent];
    context.lineWidth = agent === selected ? 3 : 2;
    context.stroke();
    context.setLineDash([]);
  });
}

function sameRings(a: Float64Array[], b: Float64Array[]): boolean {
  return a.length === b.length && a.every((ring, i) => ring.length === b[i].length && ring.every((v, k) => v === b[i][k]));
}

export function drawObstacles(context: CanvasRenderingContext2D, view: View, obstacles: Obstacle[], inks: Inks): void {
  for (const obstacle of obstacles) {
    trace(context, view, [obstacle.outline]);
    context.fillStyle = withAlpha(inks.paper, 0.75);
    context.fill();
    context.fillStyle = hatch(context, inks.ink);
    context.fill();
    context.strokeStyle = inks.ink;
    context.lineWidth = 1.6;
    context.stroke();
  }
}

/** Of more agents at once the jumps from waypoint to waypoint would hide the map. */
const JUMPS_UP_TO = 8;

/** The paths flown, drawn on as they grow. */
export class Trails {
  private drawnView = -1;
  private drawnLook = -1;
  private upTo = -Infinity;
  private done: number[] = [];

  /** Draw up to x; what is there already stays unless the view changed or x went back. `jumps`: nothing flies. */
  draw(context: CanvasRenderingContext2D, view: View, world: World, paths: Path[], jumps: boolean, selected: number, x: number, look: number, inks: Inks, cleared: boolean): void {
    if (cleared || this.drawnView !== view.revision || this.drawnLook !== look || x < this.upTo) this.done = [];
    this.drawnView = view.revision;
    this.drawnLook = look;
    this.upTo = x;
    paths.forEach((path, agent) => {
      if (jumps && paths.length > JUMPS_UP_TO && agent !== selected) return;
      const last = lastAtOrBefore(path.x, x);
      let from = this.done[agent] ?? 0;
      if (from > last) from = 0;
      if (last <= from) return;
      const points = path.points;
      context.beginPath();
      context.moveTo(view.x(points[3 * from]), view.y(points[3 * from + 1]));
      for (let i = from + 1; i <= last; i++) context.lineTo(view.x(points[3 * i]), view.y(points[3 * i + 1]));
      if (jumps) {
        context.setLineDash([2, 4]);
        context.strokeStyle = withAlpha(inks.ink, 0.6);
        context.lineWidth = 1.3;
        context.stroke();
        context.setLineDash([]);
      } else {
        if (paths.length <= 40) {
          context.strokeStyle = withAlpha(inks.ink, 0.65);
          context.lineWidth = 3.2;
          context.stroke();
        }
        context.strokeStyle = world.colours[agent];
        context.lineWidth = 1.8;
        context.stroke();
      }
      this.done[agent] = last;
    });
  }

  /** Whether the canvas must be cleared before `draw`. */
  stale(view: View, x: number, look: number): boolean {
    return this.drawnView !== view.revision || this.drawnLook !== look || x < this.upTo;
  }

  forget(): void {
    this.drawnView = -1;
  }
}

/** A step of 1, 2 or 5 times a power of ten that leaves at least `room` pixels between ticks. */
export function niceStep(scale: number, room: number): number {
  const least = room / scale;
  const power = 10 ** Math.floor(Math.log10(least));
  for (const factor of [1, 2, 5]) if (factor * power >= least * (1 - 1e-9)) return factor * power;
  return 10 * power;
}

function label(value: number, step: number): string {
  const digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  return (Math.abs(value) < step / 2 ? 0 : value).toFixed(digits).replace("-", "−");
}

/** Axes in metres along the left and the lower edge. */
export function drawAxes(context: CanvasRenderingContext2D, view: View, inks: Inks, georeferenced: boolean, font: string): void {
  const { width, height, scale } = view;
  const [left, bottom] = [view.frameLeft, view.frameBottom];
  context.fillStyle = inks.paper;
  context.fillRect(0, 0, left, height);
  context.fillRect(0, bottom, width, height - bottom);
  const step = niceStep(scale, 62);
  context.font = `11px ${font}`;
  context.fillStyle = inks.faint;
  context.strokeStyle = inks.line;
  context.lineWidth = 1;
  context.beginPath();
  context.textAlign = "center";
  context.textBaseline = "top";
  for (let k = Math.ceil(view.worldX(left) / step); k * step <= view.worldX(width); k++) {
    const x = Math.round(view.x(k * step)) + 0.5;
    context.moveTo(x, bottom);
    context.lineTo(x, bottom + 4);
    if (x > left + 10 && x < width - 64) context.fillText(label(k * step, step), x, bottom + 7);
  }
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (let k = Math.ceil(view.worldY(bottom) / step); k * step <= view.worldY(0); k++) {
    const y = Math.round(view.y(k * step)) + 0.5;
    context.moveTo(left, y);
    if (y <= 26) continue; // there is the name of the axis
    context.lineTo(left - 4, y);
    if (y < bottom - 6) context.fillText(label(k * step, step), left - 7, y);
  }
  context.moveTo(left + 0.5, 0);
  context.lineTo(left + 0.5, bottom + 0.5);
  context.lineTo(width, bottom + 0.5);
  context.stroke();
  context.textAlign = "right";
  context.textBaseline = "top";
  context.fillText(georeferenced ? "east [m]" : "x [m]", width - 8, bottom + 7);
  context.textAlign = "left";
  context.fillText(georeferenced ? "north [m]" : "y [m]", 4, 6);
}

/** Faint lines where no landmarks are, so that distances can be read. */
export function drawGrid(context: CanvasRenderingContext2D, view: View, inks: Inks): void {
  const step = niceStep(view.scale, 62);
  context.strokeStyle = withAlpha(inks.faint, 0.18);
  context.lineWidth = 1;
  context.beginPath();
  for (let k = Math.ceil(view.worldX(0) / step); k * step <= view.worldX(view.width); k++) {
    const x = Math.round(view.x(k * step)) + 0.5;
    context.moveTo(x, 0);
    context.lineTo(x, view.height);
  }
  for (let k = Math.ceil(view.worldY(view.height) / step); k * step <= view.worldY(0); k++) {
    const y = Math.round(view.y(k * step)) + 0.5;
    context.moveTo(0, y);
    context.lineTo(view.width, y);
  }
  context.stroke();
}

/** Each agent's number once, on the cell of its own that is nearest to the middle of all of them. */
export function drawPartitionNumbers(
  context: CanvasRenderingContext2D, view: View, world: World, state: State, font: string,
): void {
  const { n, m, positions } = world;
  const sums = new Float64Array(3 * m);
  for (let k = 0; k < n; k++) {
    const owner = state.owner[k];
    if (owner < 0) continue;
    sums[3 * owner] += positions[3 * k];
    sums[3 * owner + 1] += positions[3 * k + 1];
    sums[3 * owner + 2] += 1;
  }
  const best = new Float64Array(m).fill(Infinity);
  const chosen = new Int32Array(m).fill(-1);
  for (let k = 0; k < n; k++) {
    const owner = state.owner[k];
    if (owner < 0) continue;
    const count = sums[3 * owner + 2];
    const dx = positions[3 * k] - sums[3 * owner] / count;
    const dy = positions[3 * k + 1] - sums[3 * owner + 1] / count;
    const away = dx * dx + dy * dy;
    if (away < best[owner]) {
      best[owner] = away;
      chosen[owner] = k;
    }
  }
  context.font = `600 ${m <= 16 ? 15 : 11}px ${font}`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = "#ffffff";
  context.fillStyle = "#1a1a1a";
  for (let agent = 0; agent < m; agent++) {
    const k = chosen[agent];
    if (k < 0) continue;
    const [x, y] = [view.x(positions[3 * k]), view.y(positions[3 * k + 1])];
    context.strokeText(String(agent + 1), x, y);
    context.fillText(String(agent + 1), x, y);
  }
}
