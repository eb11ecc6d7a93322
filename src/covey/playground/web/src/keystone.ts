// The plane of the mission onto the four corners of a projector's picture.

import { memory } from "./dom";

export interface Point {
  x: number;
  y: number;
}

/** The homography that takes the corners of a width × height sheet (from the upper left, clockwise) to `to`: nine numbers, row by row. */
export function homography(width: number, height: number, to: Point[]): number[] {
  const from = [[0, 0], [width, 0], [width, height], [0, height]];
  const rows: number[][] = [];
  from.forEach(([x, y], i) => {
    const { x: u, y: v } = to[i];
    rows.push([x, y, 1, 0, 0, 0, -u * x, -u * y, u], [0, 0, 0, x, y, 1, -v * x, -v * y, v]);
  });
  for (let column = 0; column < 8; column++) {
    let pivot = column;
    for (let r = column + 1; r < 8; r++) if (Math.abs(rows[r][column]) > Math.abs(rows[pivot][column])) pivot = r;
    [rows[column], rows[pivot]] = [rows[pivot], rows[column]];
    for (let r = 0; r < 8; r++) {
      if (r === column) continue;
      const factor = rows[r][column] / rows[column][column];
      for (let k = column; k < 9; k++) rows[r][k] -= factor * rows[column][k];
    }
  }
  return [...rows.map((row, i) => row[8] / row[i]), 1];
}

export function project(h: number[], { x, y }: Point): Point {
  const w = h[6] * x + h[7] * y + h[8];
  return { x: (h[0] * x + h[1] * y + h[2]) / w, y: (h[3] * x + h[4] * y + h[5]) / w };
}

export function matrix3d(h: number[]): string {
  const columns = [h[0], h[3], 0, h[6], h[1], h[4], 0, h[7], 0, 0, 1, 0, h[2], h[5], 0, h[8]];
  return `matrix3d(${columns.map((value) => value.toPrecision(12)).join(",")})`;
}

/** Whether four corners enclose an area that a picture can be drawn into: all turns go the same way. */
export function isConvex(corners: Point[]): boolean {
  const turns = corners.map((a, i) => {
    const [b, c] = [corners[(i + 1) % 4], corners[(i + 2) % 4]];
    return (b.x - a.x) * (c.y - b.y) - (b.y - a.y) * (c.x - b.x);
  });
  return turns.every((turn) => turn > 1) || turns.every((turn) => turn < -1);
}

/** Each screen keeps a calibration of its own for each mission's area. */
function key(area: string): string {
  const { width, height } = screen;
  const place = screen as Screen & { availLeft?: number; availTop?: number };
  return `keystone.${width}x${height}@${place.availLeft ?? 0},${place.availTop ?? 0}.${area}`;
}

export function remember(area: string, corners: Point[]): void {
  memory.set(key(area), JSON.stringify(corners));
}

export function recall(area: string): Point[] | null {
  const text = memory.get(key(area));
  if (!text) return null;
  try {
    const corners = JSON.parse(text) as Point[];
    const sound = Array.isArray(corners) && corners.length === 4 && corners.every(({ x, y }) => Number.isFinite(x) && Number.isFinite(y));
    return sound && isConvex(corners) ? corners : null;
  } catch {
    return null;
  }
}
