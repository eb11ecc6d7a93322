// Landmarks that are the cells of a square grid, as in `covey.environment.lattice`.

import type { World } from "./state";

const OFF_GRID = 1e-3;

export interface Lattice {
  rows: number;
  columns: number;
  /** Landmark of each cell, -1 for none; row 0 has the largest y, as in an image. */
  index: Int32Array;
  /** Cell of each landmark, -1 for those that are loose. */
  cell: Int32Array;
  /** The landmarks that are no cells: points, to be drawn on top of these. */
  loose: Int32Array;
  xMin: number;
  yMax: number;
  size: number;
}

/**
 * The grid of the first landmark, since those added to a mission come last. Loose are landmarks off it, or in a cell that one before them has.
 *
 * Null unless more than half of the landmarks are cells, or if hardly any of the grid's cells are landmarks.
 */
export function findLattice(world: World): Lattice | null {
  const { n, positions, cellSize: size } = world;
  if (!(size > 0) || n === 0) return null;
  const steps = new Float64Array(2 * n);
  const onGrid: number[] = [];
  let [left, bottom, right, top] = [0, 0, 0, 0];
  for (let k = 0; k < n; k++) {
    const [x, y] = [(positions[3 * k] - positions[0]) / size, (positions[3 * k + 1] - positions[1]) / size];
    const [j, i] = [Math.round(x), Math.round(y)];
    if (Math.abs(positions[3 * k + 2]) > 1e-6 || Math.abs(x - j) > OFF_GRID || Math.abs(y - i) > OFF_GRID) continue;
    [left, bottom, right, top] = [Math.min(left, j), Math.min(bottom, i), Math.max(right, j), Math.max(top, i)];
    steps[2 * k] = j;
    steps[2 * k + 1] = i;
    onGrid.push(k);
  }
  const [columns, rows] = [right - left + 1, top - bottom + 1];
  if (columns * rows > 1000 + 50 * n) return null;
  const index = new Int32Array(columns * rows).fill(-1);
  const cell = new Int32Array(n).fill(-1);
  for (const k of onGrid) {
    const at = (top - steps[2 * k + 1]) * columns + steps[2 * k] - left;
    if (index[at] >= 0) continue;
    index[at] = k;
    cell[k] = at;
  }
  const loose: number[] = [];
  for (let k = 0; k < n; k++) if (cell[k] < 0) loose.push(k);
  if (2 * loose.length >= n) return null;
  const [xMin, yMax] = [positions[0] + (left - 0.5) * size, positions[1] + (top + 0.5) * size];
  return { rows, columns, index, cell, loose: Int32Array.from(loose), xMin, yMax, size };
}

/** Which landmark's cell holds a point, -1 for none. */
export function landmarkAt(lattice: Lattice, x: number, y: number): number {
  const j = Math.floor((x - lattice.xMin) / lattice.size);
  const i = Math.floor((lattice.yMax - y) / lattice.size);
  if (i < 0 || j < 0 || i >= lattice.rows || j >= lattice.columns) return -1;
  return lattice.index[i * lattice.columns + j];
}
