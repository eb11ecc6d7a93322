// The map: three layers of Canvas 2-D, each drawn only when what it shows has changed.

import { Agents, type AgentLook } from "./agents";
import { Cells } from "./cells";
import { readInks, type Inks } from "./colour";
import { landmarkAt } from "./lattice";
import { drawAxes, drawGrid, drawObstacles, drawPartitionNumbers, drawRegions, Trails } from "./scenery";
import type { Session } from "./session";
import { teamScore, type State, type World } from "./state";
import { include, noBounds, View, type Bounds } from "./view";
import { heatMap } from "./visibility";

const NUMBERS_EVERY = 250;

export interface Selection {
  agent: number;
  hovered: number;
  fields: boolean;
  /** What the server computed for a sensor that the page does not know. */
  seen: { agent: number; visibility: Float32Array } | null;
}

export class WorldMap {
  readonly view: View;
  private readonly layers: { canvas: HTMLCanvasElement; context: CanvasRenderingContext2D }[];
  private cells: Cells | null = null;
  private agents: Agents | null = null;
  private readonly trails = new Trails();
  private inks: Inks = readInks();
  private font = "system-ui";
  private scenes = -1;
  private ratio = 1;
  private look = 0;
  private lastSelected = -1;
  private seen: Float32Array | null = null;
  private given: Float32Array | null = null;
  private seenFor = "";
  private sceneryKey = "";
  private numbersAt = 0;
  private numbersStale = true;
  private numbersShown = false;
  private mission = "";

  constructor(
    frame: HTMLElement,
    /** Without axes and with a size of its own, for the projector. */
    private readonly bare: boolean,
  ) {
    this.view = bare ? View.bare() : new View();
    this.layers = ["cells", "scenery", "agents"].map((name) => {
      const canvas = document.createElement("canvas");
      canvas.className = "layer";
      canvas.dataset.layer = name;
      frame.append(canvas);
      const context = canvas.getContext("2d", { alpha: name !== "cells" });
      if (!context) throw new Error("this browser has no Canvas 2-D");
      return { canvas, context };
    });
    this.setTheme();
  }

  setTheme(): void {
    this.inks = readInks();
    this.font = getComputedStyle(document.body).fontFamily;
    this.cells?.setInks(this.inks);
    this.look++;
  }

  /** Whether something is still to be drawn that need not be drawn in every frame. */
  get unfinished(): boolean {
    return this.numbersStale && this.numbersShown && performance.now() - this.numbersAt > NUMBERS_EVERY;
  }

  resize(width: number, height: number, ratio: number): void {
    this.view.resize(width, height);
    this.ratio = ratio;
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    for (const { canvas } of this.layers) {
      if (canvas.width === w && canvas.height === h) continue;
      canvas.width = w;
      canvas.height = h;
      canvas.style.width = `${width}px`;
      canvas.style.height = `${height}px`;
      this.look++;
      this.trails.forget();
    }
  }

  /** Draw what changed. */
  draw(session: Session, selection: Selection): void {
    const { world, state, timeline } = session;
    if (!world || !state || !timeline || this.view.width < 2) return;
    if (this.scenes !== session.scenes) this.open(world, state, session.scenes);
    const { cells, agents } = this;
    if (!cells || !agents) return;
    this.updateHeat(world, state, selection);
    const changed = session.dirty.all || session.dirty.cells.length > 0;
    cells.draw(this.layers[0].context, this.ratio, this.view, state, session.dirty, this.seen, selection.agent, this.look);
    session.dirty.clear();
    if (changed) this.numbersStale = true;
    this.drawScenery(world, state, session, selection);
    const look: AgentLook = {
      selected: selection.agent, hovered: selection.hovered, fields: selection.fields, dark: document.documentElement.dataset.theme === "dark",
    };
    const partners = selection.agent >= 0 ? timeline.partners(selection.agent, session.x) : [];
    agents.draw(this.layers[2].context, this.ratio, this.view, state, partners, look, this.inks, this.font);
  }

  /** The landmarks that are points among cells. */
  get loose(): Int32Array | null {
    return this.cells?.lattice?.loose ?? null;
  }

  /** The landmark under a place on the screen, or -1. */
  landmarkAt(world: World, x: number, y: number): number {
    const [wx, wy] = [this.view.worldX(x), this.view.worldY(y)];
    const lattice = this.cells?.lattice;
    const reach = Math.max(6, (this.cells?.dotSize(this.view) ?? 0) * 0.6) / this.view.scale;
    let [best, found] = [reach, -1];
    for (let i = 0; i < (lattice?.loose.length ?? world.n); i++) {
      const k = lattice ? lattice.loose[i] : i;
      const away = Math.hypot(world.positions[3 * k] - wx, world.positions[3 * k + 1] - wy);
      if (away < best) [best, found] = [away, k];
    }
    if (lattice && found < 0) return landmarkAt(lattice, wx, wy);
    return found;
  }

  agentAt(state: State, x: number, y: number, reach = 18): number {
    return this.agents?.at(this.view, state, x, y, reach) ?? -1;
  }

  private open(world: World, state: State, scenes: number): void {
    this.scenes = scenes;
    this.cells = new Cells(world, this.inks);
    this.agents = new Agents(world);
    this.trails.forget();
    this.look++;
    if (this.mission !== world.scene.mission) {
      this.mission = world.scene.mission;
      this.view.fit(extent(world, state, this.bare));
    }
  }

  private updateHeat(world: World, state: State, selection: Selection): void {
    const { agent } = selection;
    const pose = agent >= 0 ? state.poses.subarray(7 * agent, 7 * agent + 7).join(" ") : "";
    const key = agent < 0 ? "" : `${agent} ${pose} ${this.scenes}`;
    const given = selection.seen?.agent === agent && selection.seen.visibility.length === world.n ? selection.seen.visibility : null;
    if (key !== this.seenFor || given !== this.given) {
      this.seenFor = key;
      this.given = given;
      this.seen = agent < 0 || agent >= world.m ? null : (heatMap(world, state, agent) ?? given);
      this.look++;
    }
    if (agent !== this.lastSelected) {
      this.lastSelected = agent;
      this.look++;
    }
  }

  private drawScenery(world: World, state: State, session: Session, selection: Selection): void {
    const { context } = this.layers[1];
    const { view, inks } = this;
    const numbered = world.cellSize * view.scale >= 15 && !this.seen;
    const now = performance.now();
    this.numbersShown = !numbered && !this.seen;
    const numbersDue = this.numbersShown && this.numbersStale && now - this.numbersAt > NUMBERS_EVERY;
    const key = `${view.revision} ${this.look} ${state.obstacles.length} ${this.scenes} ${session.timeline?.restored}`;
    const stale = key !== this.sceneryKey || numbersDue || this.trails.stale(view, session.x, this.look);
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    if (stale) {
      this.sceneryKey = key;
      context.clearRect(0, 0, view.width, view.height);
      if (!this.bare && !this.cells?.lattice) drawGrid(context, view, inks);
      drawRegions(context, view, world, inks, selection.agent);
      drawObstacles(context, view, state.obstacles, inks);
    }
    if (!this.bare) this.trails.draw(context, view, world, session.timeline?.paths ?? [], state.flown === null, selection.agent, session.x, this.look, inks, stale);
    if (stale) {
      if (this.numbersShown) {
        drawPartitionNumbers(context, view, world, state, this.font);
        this.numbersAt = now;
        this.numbersStale = false;
      }
      if (!this.bare) drawAxes(context, view, inks, world.scene.origin_lonlat_deg !== null, this.font);
    }
  }
}

/** Everything that there is to see, with a margin. */
export function extent(world: World, state: State, tight = false): Bounds {
  const bounds = noBounds();
  include(bounds, world.positions, 3, world.cellSize / 2);
  for (const ring of world.region) include(bounds, ring, 2);
  if (!tight) {
    for (const region of world.regions) for (const ring of region) include(bounds, ring, 2);
    for (const obstacle of state.obstacles) include(bounds, obstacle.outline, 2);
    for (let agent = 0; agent < world.m; agent++) {
      const pose = state.poses.subarray(7 * agent, 7 * agent + 2);
      if (Number.isFinite(pose[0])) include(bounds, pose, 2);
    }
  }
  const margin = tight ? 0 : 0.035 * Math.max(bounds.xMax - bounds.xMin, bounds.yMax - bounds.yMin, 1e-3);
  return { xMin: bounds.xMin - margin, xMax: bounds.xMax + margin, yMin: bounds.yMin - margin, yMax: bounds.yMax + margin };
}

/** A plain copy of the state, for tests and for the curious. */
export function describe(session: Session, map: WorldMap): Record<string, unknown> | null {
  const { world, state, timeline } = session;
  if (!world || !state || !timeline) return null;
  const trading: number[] = [];
  state.trading.forEach((flag, k) => flag && trading.push(k));
  return {
    mission: world.scene.mission, status: session.status, x: session.x, time: state.time, score: teamScore(state), trades: state.trades,
    bound: state.bound, owner: [...state.owner], trading, weights: [...state.weights], activity: [...state.activity], poses: [...state.poses],
    flown: state.flown && [...state.flown], obstacles: state.obstacles.length, colours: world.colours, entries: timeline.entries.length,
    flownPoints: timeline.flown.x.length, pathStarts: timeline.paths.map((path) => [path.x[0], ...path.points.slice(0, 3)]),
    pathPoints: timeline.paths.reduce((sum, path) => sum + path.x.length, 0), scorePoints: timeline.score.x.length,
    cellPixels: world.cellSize * map.view.scale, loose: map.loose && [...map.loose],
  };
}
