// The landmarks: each a cell in its owner's colour, white while it is traded; or the heat map of one agent.

import { css, heat, inkOn, parse, pixel, type Inks, type Rgb } from "./colour";
import { findLattice, landmarkAt, type Lattice } from "./lattice";
import { NOBODY } from "./messages";
import type { Dirty, State, World } from "./state";
import type { View } from "./view";

const NUMBERED_FROM = 15;
const SHAPES_FROM = 7;
const MOST_SHAPES = 12_000;
const WHITE: Rgb = { r: 255, g: 255, b: 255 };

/** Colours of the cells and where they are drawn. */
export class Cells {
  readonly lattice: Lattice | null;
  private readonly shades: Rgb[];
  private readonly image: ImageData | null = null;
  private readonly words: Uint32Array | null = null;
  private readonly bitmap: OffscreenCanvas | null = null;
  private readonly sprites = new Map<string, OffscreenCanvas>();
  /** Those that cannot be drawn alone: loose landmarks, and the cells that these may lie on. */
  private readonly covered = new Set<number>();
  private drawnView = -1;
  private drawnLook = -1;
  private heaviest = 1;

  constructor(
    private readonly world: World,
    private inks: Inks,
  ) {
    this.lattice = findLattice(world);
    this.shades = world.colours.map(parse);
    if (this.lattice) {
      this.image = new ImageData(this.lattice.columns, this.lattice.rows);
      this.words = new Uint32Array(this.image.data.buffer);
      this.bitmap = new OffscreenCanvas(this.lattice.columns, this.lattice.rows);
      for (const k of this.lattice.loose) this.cover(this.lattice, k);
    }
  }

  private cover(lattice: Lattice, loose: number): void {
    const { positions } = this.world;
    this.covered.add(loose);
    for (const dx of [-0.5, 0.5]) {
      for (const dy of [-0.5, 0.5]) {
        const k = landmarkAt(lattice, positions[3 * loose] + dx * lattice.size, positions[3 * loose + 1] + dy * lattice.size);
        if (k >= 0) this.covered.add(k);
      }
    }
  }

  setInks(inks: Inks): void {
    this.inks = inks;
  }

  /** Colour of a landmark's cell, and how strongly it is laid on: a landmark that is worth less is paler. */
  shade(state: State, k: number, seen: Float32Array | null): { colour: Rgb; alpha: number } {
    const weight = state.weights[k];
    if (!(weight > 0)) return { colour: WHITE, alpha: 0 };
    const alpha = 0.3 + 0.7 * Math.min(1, weight / this.heaviest);
    if (seen) return { colour: heat(seen[k]), alpha };
    if (state.trading[k]) return { colour: WHITE, alpha: 1 };
    const owner = state.owner[k];
    return { colour: owner === NOBODY ? parse(this.inks.unowned) : this.shades[owner], alpha };
  }

  /**
   * Draw what changed, or everything.
   *
   * `look` counts whatever else changes how all cells look: theme, selection, heat map.
   */
  draw(context: CanvasRenderingContext2D, ratio: number, view: View, state: State, dirty: Dirty, seen: Float32Array | null, outlined: number, look: number): void {
    const all = dirty.all || this.drawnView !== view.revision || this.drawnLook !== look;
    if (!all && dirty.cells.length === 0) return;
    if (dirty.all || this.drawnLook !== look) this.heaviest = this.findHeaviest(state);
    const size = this.world.cellSize * view.scale;
    const shapes = this.lattice !== null && size >= SHAPES_FROM && this.visibleCells(view) <= MOST_SHAPES;
    if (this.lattice) this.paint(state, dirty.all || this.drawnLook !== look ? null : dirty.cells, seen);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const buried = this.covered.size > 0 && dirty.cells.some((k) => this.covered.has(k));
    if (all || !shapes || seen || buried) {
      context.fillStyle = this.inks.paper;
      context.fillRect(0, 0, view.width, view.height);
      if (!this.lattice) this.drawPoints(context, view, state, seen);
      else if (shapes) this.drawShapes(context, view, state, seen, this.visible(view), false);
      else this.drawImage(context, view);
      if (seen) this.outline(context, view, state, outlined);
      if (this.lattice) this.drawLoose(context, view, state, seen, this.lattice.loose);
    } else {
      this.drawShapes(context, view, state, seen, dirty.cells, true);
    }
    this.drawnView = view.revision;
    this.drawnLook = look;
  }

  /** Bitmap of the lattice, one pixel a cell, row 0 with the largest y; null where landmarks are points. */
  get texture(): OffscreenCanvas | null {
    return this.bitmap;
  }

  /** Bring the bitmap up to date. */
  paint(state: State, cells: Iterable<number> | null, seen: Float32Array | null): void {
    const { lattice, words, image, bitmap } = this;
    if (!lattice || !words || !image || !bitmap) return;
    let [top, bottom] = [lattice.rows, -1];
    const set = (k: number): void => {
      const at = lattice.cell[k];
      if (at < 0) return;
      const { colour, alpha } = this.shade(state, k, seen);
      words[at] = pixel(colour, Math.round(255 * alpha));
      const row = Math.floor(at / lattice.columns);
      if (row < top) top = row;
      if (row > bottom) bottom = row;
    };
    if (cells) for (const k of cells) set(k);
    else for (let k = 0; k < this.world.n; k++) set(k);
    if (bottom < top) return;
    bitmap.getContext("2d")?.putImageData(image, 0, 0, 0, top, lattice.columns, bottom - top + 1);
  }

  private findHeaviest(state: State): number {
    let most = 0;
    for (const weight of state.weights) if (weight > most) most = weight;
    return most || 1;
  }

  private visibleCells(view: View): number {
    const lattice = this.lattice;
    if (!lattice) return 0;
    const size = lattice.size * view.scale;
    return Math.min(lattice.columns, view.width / size + 1) * Math.min(lattice.rows, view.height / size + 1);
  }

  private *visible(view: View): Generator<number> {
    const lattice = this.lattice;
    if (!lattice) return;
    const clamp = (value: number, most: number): number => Math.min(Math.max(value, 0), most);
    const j0 = clamp(Math.floor((view.worldX(0) - lattice.xMin) / lattice.size), lattice.columns);
    const j1 = clamp(Math.ceil((view.worldX(view.width) - lattice.xMin) / lattice.size), lattice.columns);
    const i0 = clamp(Math.floor((lattice.yMax - view.worldY(0)) / lattice.size), lattice.rows);
    const i1 = clamp(Math.ceil((lattice.yMax - view.worldY(view.height)) / lattice.size), lattice.rows);
    for (let i = i0; i < i1; i++) {
      for (let j = j0; j < j1; j++) {
        const k = lattice.index[i * lattice.columns + j];
        if (k >= 0) yield k;
      }
    }
  }

  private drawImage(context: CanvasRenderingContext2D, view: View): void {
    const { lattice, bitmap } = this;
    if (!lattice || !bitmap) return;
    context.imageSmoothingEnabled = false;
    const [w, h] = [lattice.columns * lattice.size * view.scale, lattice.rows * lattice.size * view.scale];
    context.drawImage(bitmap, view.x(lattice.xMin), view.y(lattice.yMax), w, h);
  }

  /** The border of what an agent owns. */
  private outline(context: CanvasRenderingContext2D, view: View, state: State, agent: number): void {
    const { lattice } = this;
    if (!lattice) return;
    const own = (i: number, j: number): boolean => {
      if (i < 0 || j < 0 || i >= lattice.rows || j >= lattice.columns) return false;
      const k = lattice.index[i * lattice.columns + j];
      return k >= 0 && state.owner[k] === agent;
    };
    const size = lattice.size * view.scale;
    const [left, top] = [view.x(lattice.xMin), view.y(lattice.yMax)];
    context.beginPath();
    for (let i = 0; i < lattice.rows; i++) {
      for (let j = 0; j < lattice.columns; j++) {
        if (!own(i, j)) continue;
        const [x, y] = [left + j * size, top + i * size];
        const sides: [boolean, number, number, number, number][] = [
          [own(i - 1, j), x, y, x + size, y], [own(i + 1, j), x, y + size, x + size, y + size],
          [own(i, j - 1), x, y, x, y + size], [own(i, j + 1), x + size, y, x + size, y + size],
        ];
        for (const [inside, x0, y0, x1, y1] of sides) {
          if (inside) continue;
          context.moveTo(x0, y0);
          context.lineTo(x1, y1);
        }
      }
    }
    context.lineCap = "round";
    context.strokeStyle = "#ffffff";
    context.lineWidth = 4;
    context.stroke();
    context.strokeStyle = this.world.colours[agent];
    context.lineWidth = 2.5;
    context.stroke();
  }

  private drawShapes(
    context: CanvasRenderingContext2D, view: View, state: State, seen: Float32Array | null, cells: Iterable<number>, erase: boolean,
  ): void {
    const size = this.world.cellSize * view.scale;
    const gap = size >= 12 ? 1 : 0.5;
    const numbered = size >= NUMBERED_FROM && !seen;
    const { positions } = this.world;
    for (const k of cells) {
      const x = view.x(positions[3 * k]) - size / 2;
      const y = view.y(positions[3 * k + 1]) - size / 2;
      if (x > view.width || y > view.height || x + size < 0 || y + size < 0) continue;
      const { colour, alpha } = this.shade(state, k, seen);
      if (erase) {
        context.fillStyle = this.inks.paper;
        context.fillRect(x, y, size, size);
      }
      context.globalAlpha = alpha;
      context.fillStyle = css(colour);
      context.fillRect(x + gap / 2, y + gap / 2, size - gap, size - gap);
      context.globalAlpha = 1;
      if (alpha === 0) continue;
      if (state.trading[k] && !seen) {
        context.strokeStyle = "#1a1a1a";
        context.lineWidth = 1;
        context.strokeRect(x + gap / 2 + 0.5, y + gap / 2 + 0.5, size - gap - 1, size - gap - 1);
      }
      if (numbered && state.owner[k] !== NOBODY) {
        const sprite = this.number(state.owner[k], state.trading[k] !== 0, alpha, size);
        context.drawImage(sprite, x + size / 2 - sprite.width / 4, y + size / 2 - sprite.height / 4, sprite.width / 2, sprite.height / 2);
      }
    }
  }

  /** An agent's number, drawn once and copied into its cells. */
  private number(owner: number, trading: boolean, alpha: number, size: number): OffscreenCanvas {
    const height = Math.round(Math.min(0.46 * size, 15));
    const ink = trading || alpha < 0.65 ? (trading ? "#1a1a1a" : this.inks.ink) : inkOn(this.world.colours[owner]);
    const key = `${owner} ${ink} ${height}`;
    let sprite = this.sprites.get(key);
    if (!sprite) {
      if (this.sprites.size > 600) this.sprites.clear();
      const text = String(owner + 1);
      sprite = new OffscreenCanvas(2 * Math.ceil(height * (0.75 * text.length + 0.5)), 2 * Math.ceil(1.3 * height));
      const context = sprite.getContext("2d");
      if (context) {
        context.font = `${2 * height}px ${getComputedStyle(document.body).fontFamily}`;
        context.textAlign = "center";
        context.textBaseline = "middle";
        context.fillStyle = ink;
        context.globalAlpha = 0.8;
        context.fillText(text, sprite.width / 2, sprite.height / 2 + 0.08 * height);
      }
      this.sprites.set(key, sprite);
    }
    return sprite;
  }

  /** Points on top of the cells, each on a ground of its own, so that a pale one does not take the colour of its cell. */
  private drawLoose(context: CanvasRenderingContext2D, view: View, state: State, seen: Float32Array | null, loose: Iterable<number>): void {
    const { positions } = this.world;
    const size = this.dotSize(view);
    for (const k of loose) {
      const [x, y] = [view.x(positions[3 * k]), view.y(positions[3 * k + 1])];
      if (x < -size || y < -size || x > view.width + size || y > view.height + size) continue;
      const { colour, alpha } = this.shade(state, k, seen);
      if (alpha === 0) continue;
      context.beginPath();
      context.arc(x, y, size / 2, 0, 2 * Math.PI);
      context.fillStyle = this.inks.paper;
      context.fill();
      context.globalAlpha = alpha;
      context.fillStyle = css(colour);
      context.fill();
      context.globalAlpha = 1;
      context.strokeStyle = this.inks.ink;
      context.lineWidth = 1.2;
      context.stroke();
    }
  }

  /** Diameter of a landmark that is a point, CSS pixels. */
  dotSize(view: View): number {
    const { cellSize } = this.world;
    if (this.lattice) return Math.min(14, Math.max(5, 0.5 * cellSize * view.scale));
    if (cellSize > 0) return Math.max(2, cellSize * view.scale);
    return Math.min(14, Math.max(2.5, 0.16 * view.scale, 5 - Math.log10(this.world.n)));
  }

  private drawPoints(context: CanvasRenderingContext2D, view: View, state: State, seen: Float32Array | null): void {
    const { positions, normals, n, cellSize } = this.world;
    const size = this.dotSize(view);
    const square = cellSize > 0 || size < 5;
    const batches = new Map<string, number[]>();
    for (let k = 0; k < n; k++) {
      const x = view.x(positions[3 * k]);
      const y = view.y(positions[3 * k + 1]);
      if (x < -size || y < -size || x > view.width + size || y > view.height + size) continue;
      const { colour, alpha } = this.shade(state, k, seen);
      if (alpha === 0) continue;
      const key = `rgba(${colour.r},${colour.g},${colour.b},${Math.round(alpha * 20) / 20})`;
      const batch = batches.get(key);
      if (batch) batch.push(k);
      else batches.set(key, [k]);
    }
    if (normals && size >= 4) {
      context.beginPath();
      for (let k = 0; k < n; k++) {
        const [x, y] = [view.x(positions[3 * k]), view.y(positions[3 * k + 1])];
        context.moveTo(x, y);
        context.lineTo(x + 1.5 * size * normals[3 * k], y - 1.5 * size * normals[3 * k + 1]);
      }
      context.strokeStyle = this.inks.faint;
      context.lineWidth = 1;
      context.stroke();
    }
    for (const [colour, batch] of batches) {
      context.fillStyle = colour;
      if (square) {
        for (const k of batch) {
          context.fillRect(view.x(positions[3 * k]) - size / 2, view.y(positions[3 * k + 1]) - size / 2, size, size);
        }
        continue;
      }
      context.beginPath();
      for (const k of batch) {
        const [x, y] = [view.x(positions[3 * k]), view.y(positions[3 * k + 1])];
        context.moveTo(x + size / 2, y);
        context.arc(x, y, size / 2, 0, 2 * Math.PI);
      }
      context.fill();
      context.strokeStyle = this.inks.ink;
      context.lineWidth = 0.8;
      context.stroke();
    }
  }
}
