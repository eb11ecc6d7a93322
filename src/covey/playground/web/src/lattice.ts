// Landmarks that are the cells of a square grid, as in `covey.runtime.drawing.lattice`.

import type { World } from "./state";

export interface Lattice {
  rows: number;
  columns: number;
  /** Landmark of each cell, -1 for none; row 0 has the largest y, as in an image. */
  index: Int32Array;
  /** Cell of each landmark. */
  cell: Int32Array;
  xMin: number;
  yMax: number;
  size: number;
}

export function findLattice(world: World): Lattice | null {
  const { n, positions, cellSize: size } = world;
  if (!(size > 0) || n === 0) return null;
  let [xLow, yLow, xHigh, yHigh] = [Infinity, Infinity, -Infinity, -Infinity];
  for (let k = 0; k < n; k++) {
    if (Math.abs(positions[3 * k + 2]) > 1e-6) return null;
    xLow = Math.min(xLow, positions[3 * k]);
    xHigh = Math.max(xHigh, positions[3 * k]);
    yLow = Math.min(yLow, positions[3 * k + 1]);
    yHigh = Math.max(yHigh, positions[3 * k + 1]);
  }
  const columns = Math.round((xHigh - xLow) / size) + 1;
  const rows = Math.round((yHigh - yLow) / size) + 1;
  if (columns * rows > 1000 + 50 * n) return null;
  const index = new Int32Array(columns * rows).fill(-1);
  const cell = new Int32Array(n);
  for (let k = 0; k < n; k++) {
    const j = (positions[3 * k] - xLow) / size;
    const i = (yHigh - positions[3 * k + 1]) / size;
    if (Math.abs(j - Math.round(j)) > 1e-3 || Math.abs(i - Math.round(i)) > 1e-3) return null;
    const at = Math.round(i) * columns + Math.round(j);
    if (index[at] >= 0) return null;
    index[at] = k;
    cell[k] = at;
  }
  return { rows, columns, index, cell, xMin: xLow - size / 2, yMax: yHigh + size / 2, size };
}

/** Which landmark's cell holds a point, -1 for none. */
export function landmarkAt(lattice: Lattice, x: number, y: number): number {
  const j = Math.floor((x - lattice.xMin) / lattice.size);
  const i = Math.floor((lattice.yMax - y) / lattice.size);
  if (i < 0 || j < 0 || i >= lattice.rows || j >= lattice.columns) return -1;
  return lattice.index[i * lattice.columns + j];
}
