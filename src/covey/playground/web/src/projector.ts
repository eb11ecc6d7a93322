// The map alone, thrown onto a floor at true scale: its four corners are dragged to where they are on the floor.

import { element, make, number } from "./dom";
import { homography, isConvex, matrix3d, recall, remember, type Point } from "./keystone";
import { extent, WorldMap, type Selection } from "./map";
import type { Session } from "./session";
import type { Bounds } from "./view";

/** Of the sheet, CSS pixels before the corners are dragged: the fewer, the larger are agents and numbers on it. */
const LONGEST_SIDE = 800;
const PIXEL_RATIO = 2;
const NAMES = ["upper left", "upper right", "lower right", "lower left"];
const NOTHING: Selection = { agent: -1, hovered: -1, fields: false, seen: null };

export class Projector {
  private readonly box = element("projector");
  private readonly sheet = make("div", { class: "sheet" });
  private readonly grid = make("canvas", { class: "layer", "data-layer": "grid" });
  private map: WorldMap | null = null;
  private bounds: Bounds | null = null;
  private size = { width: 1, height: 1 };
  private corners: Point[] = [];
  private chosen = 0;
  private calibrating = false;
  private scenes = -1;
  private handles: HTMLButtonElement[] = [];
  private readonly advice = make("div", { class: "advice" });

  constructor(private readonly session: Session) {
    this.box.append(this.sheet);
    this.sheet.append(this.grid);
    window.addEventListener("resize", () => this.place());
  }

  get active(): boolean {
    return !this.box.hidden;
  }

  toggle(active: boolean): void {
    this.box.hidden = !active;
    for (const id of ["bar", "main", "steering", "player"]) element(id).inert = active;
    if (!active) this.calibrate(false);
  }

  draw(): void {
    const { world, state } = this.session;
    if (!world || !state) return;
    if (!this.map) this.map = new WorldMap(this.sheet, true);
    if (this.scenes !== this.session.scenes) {
      this.scenes = this.session.scenes;
      this.bounds = extent(world, state, true);
      const [w, h] = [this.bounds.xMax - this.bounds.xMin, this.bounds.yMax - this.bounds.yMin];
      const scale = LONGEST_SIDE / Math.max(w, h);
      this.size = { width: Math.round(w * scale), height: Math.round(h * scale) };
      this.sheet.style.width = `${this.size.width}px`;
      this.sheet.style.height = `${this.size.height}px`;
      this.map.resize(this.size.width, this.size.height, PIXEL_RATIO);
      this.map.view.fit(this.bounds);
      this.sheet.append(this.grid);
      this.corners = recall(this.area()) ?? this.fitted();
      this.place();
      this.drawGrid();
      if (!recall(this.area())) this.calibrate(true);
    }
    this.map.draw(this.session, NOTHING);
  }

  /** What a key means here; whether it means anything. */
  key(event: KeyboardEvent): boolean {
    const far = event.shiftKey ? 10 : event.altKey ? 0.25 : 1;
    const moves: Record<string, [number, number]> = { ArrowLeft: [-far, 0], ArrowRight: [far, 0], ArrowUp: [0, -far], ArrowDown: [0, far] };
    if (event.key === "c") this.calibrate(!this.calibrating);
    else if (event.key === "r" && this.calibrating) this.moveTo(this.fitted());
    else if ("1234".includes(event.key) && this.calibrating) this.choose(Number(event.key) - 1);
    else if (event.key === "f") void (document.fullscreenElement ? document.exitFullscreen() : this.box.requestFullscreen());
    else if (Object.hasOwn(moves, event.key) && this.calibrating) {
      const [dx, dy] = moves[event.key];
      const { x, y } = this.corners[this.chosen];
      this.moveCorner(this.chosen, { x: x + dx, y: y + dy });
    } else if (event.key === "Escape") {
      if (this.calibrating) this.calibrate(false);
      else location.hash = "";
    } else return false;
    return true;
  }

  private area(): string {
    const b = this.bounds;
    return b ? [b.xMin, b.xMax, b.yMin, b.yMax].map((value) => value.toFixed(3)).join(",") : "";
  }

  /** The largest upright picture that fits the screen. */
  private fitted(): Point[] {
    const { innerWidth: w, innerHeight: h } = window;
    const scale = 0.94 * Math.min(w / this.size.width, h / this.size.height);
    const [dx, dy] = [(this.size.width * scale) / 2, (this.size.height * scale) / 2];
    return [[-dx, -dy], [dx, -dy], [dx, dy], [-dx, dy]].map(([x, y]) => ({ x: w / 2 + x, y: h / 2 + y }));
  }

  private place(): void {
    if (this.corners.length !== 4) return;
    this.sheet.style.transform = matrix3d(homography(this.size.width, this.size.height, this.corners));
    this.handles.forEach((handle, i) => {
      handle.style.left = `${this.corners[i].x}px`;
      handle.style.top = `${this.corners[i].y}px`;
    });
  }

  private moveTo(corners: Point[]): void {
    if (!isConvex(corners)) return;
    this.corners = corners;
    remember(this.area(), corners);
    this.place();
  }

  private moveCorner(index: number, to: Point): void {
    this.moveTo(this.corners.map((corner, i) => (i === index ? to : corner)));
  }

  private choose(index: number): void {
    this.chosen = index;
    this.handles.forEach((handle, i) => handle.setAttribute("aria-pressed", String(i === index)));
    this.handles[index]?.focus();
  }

  private calibrate(on: boolean): void {
    this.calibrating = on;
    this.grid.hidden = !on;
    this.handles.forEach((handle) => handle.remove());
    this.advice.remove();
    this.handles = [];
    if (!on || !this.bounds) return;
    const { xMin, xMax, yMin, yMax } = this.bounds;
    const places = [[xMin, yMax], [xMax, yMax], [xMax, yMin], [xMin, yMin]];
    this.handles = places.map(([x, y], i) => {
      const where = `(${number(x, 2)}, ${number(y, 2)}) m`;
      const handle = make("button", { type: "button", class: "corner", "aria-label": `${NAMES[i]} corner, ${where}`, title: where }, String(i + 1));
      handle.addEventListener("pointerdown", (event) => {
        handle.setPointerCapture(event.pointerId);
        this.choose(i);
      });
      handle.addEventListener("pointermove", (event) => {
        if (handle.hasPointerCapture(event.pointerId)) this.moveCorner(i, { x: event.clientX, y: event.clientY });
      });
      handle.addEventListener("focus", () => this.choose(i));
      return handle;
    });
    const keys = (text: string): HTMLElement => make("kbd", {}, text);
    const list = places.map(([x, y], i) => `${i + 1}: (${number(x, 2)}, ${number(y, 2)}) m`).join("   ");
    this.advice.replaceChildren(
      make("p", {}, "Mark the corners of the area on the floor, then drag each number onto its mark: ", list, ". The lines are a metre apart."),
      make("p", {}, keys("1"), " … ", keys("4"), " choose a corner, arrows move it (", keys("Shift"), " further, ", keys("Alt"), " finer), ", keys("r"), " starts again, ",
        keys("f"), " full screen, ", keys("c"), " or ", keys("Esc"), " when it fits."),
    );
    this.box.append(this.advice, ...this.handles);
    this.choose(this.chosen);
    this.place();
  }

  /** Lines a metre apart, or closer for small areas, and circles, which must be round on the floor. */
  private drawGrid(): void {
    const { bounds, grid, map } = this;
    if (!bounds || !map) return;
    const { width, height } = this.size;
    grid.width = width * PIXEL_RATIO;
    grid.height = height * PIXEL_RATIO;
    grid.style.width = `${width}px`;
    grid.style.height = `${height}px`;
    const context = grid.getContext("2d");
    if (!context) return;
    context.scale(PIXEL_RATIO, PIXEL_RATIO);
    const { view } = map;
    context.fillStyle = "#000";
    context.fillRect(0, 0, width, height);
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = "#fff";
    context.strokeStyle = "#fff";
    for (let x = Math.ceil(bounds.xMin); x <= bounds.xMax; x++) {
      context.lineWidth = x === 0 ? 2.5 : 1;
      context.strokeRect(view.x(x), -5, 0, height + 10);
      context.fillText(`x ${x}`, view.x(x) + 4, height - 6);
    }
    for (let y = Math.ceil(bounds.yMin); y <= bounds.yMax; y++) {
      context.lineWidth = y === 0 ? 2.5 : 1;
      context.strokeRect(-5, view.y(y), width + 10, 0);
      context.fillText(`y ${y}`, 5, view.y(y) - 4);
    }
    context.lineWidth = 3;
    context.strokeStyle = "#fee838";
    context.strokeRect(1.5, 1.5, width - 3, height - 3);
    context.lineWidth = 1.5;
    context.beginPath();
    const radius = 0.45 * Math.min(bounds.xMax - bounds.xMin, bounds.yMax - bounds.yMin) * view.scale;
    context.arc(width / 2, height / 2, radius, 0, 2 * Math.PI);
    context.stroke();
  }
}
