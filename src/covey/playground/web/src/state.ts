// The state of a mission at a moment: what `covey.runtime.watching.view.TeamView` is in Python.

import { NOBODY, POSE, type Encoded, type Scene, type SceneObstacle, type Update } from "./messages";
import { rings, values } from "./wire";

/** A scene with its arrays unpacked. */
export interface World {
  scene: Scene;
  n: number;
  m: number;
  names: string[];
  colours: string[];
  /** (n, 3) */
  positions: Float64Array;
  /** (n, 3), or null */
  normals: Float64Array | null;
  region: Float64Array[];
  /** Of each agent. */
  regions: Float64Array[][];
  /** Side of a cell, metres; 0 where landmarks are points. */
  cellSize: number;
}

export interface Obstacle {
  outline: Float64Array;
  zMin: number;
  zMax: number;
  radius: number;
}

export interface State {
  time: number;
  owner: Int32Array;
  /** (m, 7) committed poses */
  poses: Float64Array;
  scores: Float64Array;
  weights: Float64Array;
  activity: Uint8Array;
  /** 1 for each landmark that is offered in a trade. */
  trading: Uint8Array;
  trades: number;
  bound: number;
  obstacles: Obstacle[];
  /** (m, 7) true poses, or null where nothing flies */
  flown: Float64Array | null;
  velocities: Float64Array | null;
  objects: Float64Array;
  scoreFlown: number;
  separation: number;
  battery: Float64Array | null;
  link: Float64Array | null;
  heard: Float64Array | null;
  ended: { status: string; holds: boolean | null } | null;
}

/** What has to be drawn anew. */
export class Dirty {
  all = true;
  readonly cells: number[] = [];

  clear(): void {
    this.all = false;
    this.cells.length = 0;
  }

  add(cell: number): void {
    if (this.all) return;
    this.cells.push(cell);
    if (this.cells.length > 50000) this.all = true;
  }

  addAll(cells: Iterable<number>): void {
    for (const cell of cells) this.add(cell);
  }
}

export function openWorld(scene: Scene): World {
  const positions = values(scene.positions_W);
  return {
    scene,
    n: positions.length / 3,
    m: scene.agents.length,
    names: scene.agents.map((agent) => agent.name),
    colours: scene.agents.map((agent) => agent.colour),
    positions,
    normals: scene.normals_W && values(scene.normals_W),
    region: rings(scene.region),
    regions: scene.agents.map((agent) => rings(agent.region)),
    cellSize: scene.cell_size ?? 0,
  };
}

function obstacle(given: SceneObstacle): Obstacle {
  return { outline: values(given.outline), zMin: given.z_min, zMax: given.z_max, radius: given.radius };
}

/** The state before anything is known but the scene. */
export function initialState(world: World): State {
  const { n, m } = world;
  return {
    time: 0,
    owner: new Int32Array(n).fill(NOBODY),
    poses: new Float64Array(m * POSE).fill(NaN),
    scores: new Float64Array(m).fill(NaN),
    weights: values(world.scene.weights),
    activity: new Uint8Array(m),
    trading: new Uint8Array(n),
    trades: 0,
    bound: NaN,
    obstacles: world.scene.obstacles.map(obstacle),
    flown: null,
    velocities: null,
    objects: new Float64Array(0),
    scoreFlown: NaN,
    separation: NaN,
    battery: null,
    link: null,
    heard: null,
    ended: null,
  };
}

export function copyState(state: State): State {
  return {
    ...state,
    owner: state.owner.slice(),
    poses: state.poses.slice(),
    scores: state.scores.slice(),
    weights: state.weights.slice(),
    activity: state.activity.slice(),
    trading: state.trading.slice(),
    obstacles: state.obstacles.slice(),
  };
}

export function teamScore(state: State): number {
  let sum = 0;
  for (const score of state.scores) sum += score;
  return sum;
}

/** The pose to draw an agent at: the true one where it is known. */
export function shownPose(state: State, agent: number): Float64Array {
  const from = state.flown && !Number.isNaN(state.flown[agent * POSE]) ? state.flown : state.poses;
  return from.subarray(agent * POSE, (agent + 1) * POSE);
}

export function yawOf(pose: ArrayLike<number>): number {
  const [w, x, y, z] = [pose[3], pose[4], pose[5], pose[6]];
  return Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
}

/** Add an update up; what is drawn differently after it goes into `dirty`. */
export function apply(state: State, update: Update, dirty: Dirty): void {
  state.time = update.time;
  switch (update.type) {
    case "TeamState":
      state.owner = values(update.owner);
      state.poses = values(update.poses);
      state.scores = values(update.scores);
      state.weights = values(update.weights);
      state.activity = values(update.activity);
      state.trading.fill(0);
      for (const cell of values(update.trading)) state.trading[cell] = 1;
      state.trades = update.trades;
      state.bound = update.bound ?? NaN;
      dirty.all = true;
      break;
    case "TeamChange": {
      const cells = values(update.landmarks);
      const owner = values(update.owner);
      cells.forEach((cell, i) => (state.owner[cell] = owner[i]));
      dirty.addAll(cells);
      const poses = values(update.poses);
      update.posed.forEach((agent, i) => state.poses.set(poses.subarray(i * POSE, (i + 1) * POSE), agent * POSE));
      const scores = values(update.scores);
      update.scored.forEach((agent, i) => (state.scores[agent] = scores[i]));
      if (update.kind === "trade") state.trades += 1;
      break;
    }
    case "Trading":
      for (const encoded of [update.give, update.want]) {
        const cells = values(encoded);
        for (const cell of cells) state.trading[cell] = update.open ? 1 : 0;
        dirty.addAll(cells);
      }
      break;
    case "Weights": {
      const cells = values(update.landmarks);
      const weights = values(update.weights);
      cells.forEach((cell, i) => (state.weights[cell] = weights[i]));
      dirty.all = true; // how strong a cell's colour is depends on the heaviest of all
      break;
    }
    case "Motion":
      state.flown = values(update.poses);
      state.velocities = values(update.velocities_W);
      state.objects = values(update.objects_W);
      state.scoreFlown = update.score_flown ?? NaN;
      state.separation = update.separation ?? Infinity;
      break;
    case "Health":
      state.activity = values(update.activity);
      state.battery = known(update.battery);
      state.link = known(update.link);
      state.heard = known(update.heard);
      break;
    case "ObstacleAppeared":
      state.obstacles = [...state.obstacles, obstacle(update.obstacle)];
      break;
    case "BoundFound":
      state.bound = update.bound ?? NaN;
      break;
    case "Ended":
      state.ended = { status: update.status, holds: update.holds };
      if (state.trading.some((flag) => flag !== 0)) dirty.all = true;
      state.trading.fill(0);
      break;
    case "Note":
      break;
  }
}

function known(encoded: Encoded<"f8">): Float64Array | null {
  const array = values(encoded);
  return array.some((value) => !Number.isNaN(value)) ? array : null;
}
