// What part of the plane is shown where: metres of frame W to CSS pixels of the map.

export interface Bounds {
  xMin: number;
  xMax: number;
  yMin: number;
  yMax: number;
}

export function noBounds(): Bounds {
  return { xMin: Infinity, xMax: -Infinity, yMin: Infinity, yMax: -Infinity };
}

/** Stretch bounds around points given as rows of `stride` numbers, x and y first. */
export function include(bounds: Bounds, points: ArrayLike<number>, stride: number, margin = 0): void {
  for (let i = 0; i + 1 < points.length; i += stride) {
    const [x, y] = [points[i], points[i + 1]];
    if (x - margin < bounds.xMin) bounds.xMin = x - margin;
    if (x + margin > bounds.xMax) bounds.xMax = x + margin;
    if (y - margin < bounds.yMin) bounds.yMin = y - margin;
    if (y + margin > bounds.yMax) bounds.yMax = y + margin;
  }
}

/** Room around the map, CSS pixels: axes are written at the left and at the bottom. */
export const MARGIN = { left: 46, right: 14, top: 14, bottom: 34 };
const NO_MARGIN = { left: 0, right: 0, top: 0, bottom: 0 };

export class View {
  width = 1;
  height = 1;
  /** CSS pixels a metre. */
  scale = 50;
  centreX = 0;
  centreY = 0;
  /** Counts the changes, so that layers know when to draw anew. */
  revision = 0;
  private home: Bounds | null = null;
  /** Whether the user has moved the map; until then it is fitted again whenever its size changes. */
  private moved = false;

  constructor(readonly margin = MARGIN) {}

  static bare(): View {
    return new View(NO_MARGIN);
  }

  /** Left edge of the plot. */
  get frameLeft(): number {
    return Math.max(0, this.margin.left - 8);
  }

  /** Lower edge of the plot. */
  get frameBottom(): number {
    return this.height - Math.max(0, this.margin.bottom - 6);
  }

  resize(width: number, height: number): void {
    if (width === this.width && height === this.height) return;
    this.width = width;
    this.height = height;
    this.revision++;
    if (!this.moved && this.home) this.fit(this.home);
  }

  fit(bounds: Bounds): void {
    this.home = bounds;
    this.moved = false;
    const { left, right, top, bottom } = this.margin;
    const [w, h] = [Math.max(this.width - left - right, 10), Math.max(this.height - top - bottom, 10)];
    const dx = Math.max(bounds.xMax - bounds.xMin, 1e-6);
    const dy = Math.max(bounds.yMax - bounds.yMin, 1e-6);
    this.scale = Math.min(w / dx, h / dy);
    const midX = left + w / 2;
    const midY = top + h / 2;
    this.centreX = (bounds.xMin + bounds.xMax) / 2 - (midX - this.width / 2) / this.scale;
    this.centreY = (bounds.yMin + bounds.yMax) / 2 + (midY - this.height / 2) / this.scale;
    this.revision++;
  }

  refit(): void {
    if (this.home) this.fit(this.home);
  }

  x(worldX: number): number {
    return this.width / 2 + (worldX - this.centreX) * this.scale;
  }

  y(worldY: number): number {
    return this.height / 2 - (worldY - this.centreY) * this.scale;
  }

  worldX(x: number): number {
    return this.centreX + (x - this.width / 2) / this.scale;
  }

  worldY(y: number): number {
    return this.centreY - (y - this.height / 2) / this.scale;
  }

  pan(dx: number, dy: number): void {
    this.centreX -= dx / this.scale;
    this.centreY += dy / this.scale;
    this.moved = true;
    this.revision++;
  }

  /** Zoom so that what is at a place on the screen stays there. */
  zoomAt(x: number, y: number, factor: number): void {
    const scale = Math.min(Math.max(this.scale * factor, 1e-3), 1e5);
    const [wx, wy] = [this.worldX(x), this.worldY(y)];
    this.scale = scale;
    this.centreX = wx - (x - this.width / 2) / scale;
    this.centreY = wy + (y - this.height / 2) / scale;
    this.moved = true;
    this.revision++;
  }
}
