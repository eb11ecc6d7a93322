// What happened so far, for the score chart, the log and the paths. Bounded: when a series is full, every second point goes.

import { NOBODY, POSE, type History, type Update } from "./messages";
import { teamScore, type State, type World } from "./state";
import { values } from "./wire";

/** Points in the order of x. */
export class Series {
  readonly x: number[] = [];
  readonly y: number[] = [];

  constructor(private readonly most: number) {}

  add(x: number, y: number): void {
    this.x.push(x);
    this.y.push(y);
    if (this.x.length > this.most) this.thin();
  }

  /** Index of the last point at or before x; -1 for none. */
  at(x: number): number {
    return lastAtOrBefore(this.x, x);
  }

  private thin(): void {
    const last = this.x.length - 1;
    let kept = 0;
    for (let i = 0; i <= last; i++) {
      if (i % 2 === 0 || i === last) {
        this.x[kept] = this.x[i];
        this.y[kept++] = this.y[i];
      }
    }
    this.x.length = this.y.length = kept;
  }
}

/** Where an agent flew: x of the time line, and metres. */
export class Path {
  readonly x: number[] = [];
  readonly points: number[] = [];
  private least = 0;

  constructor(private readonly most: number) {}

  add(x: number, px: number, py: number, pz: number): void {
    const k = this.points.length;
    if (k >= 3) {
      const moved = Math.hypot(px - this.points[k - 3], py - this.points[k - 2], pz - this.points[k - 1]);
      if (moved < Math.max(0.01, this.least)) return;
    }
    this.x.push(x);
    this.points.push(px, py, pz);
    if (this.x.length > this.most) this.thin();
  }

  /** How many points are at or before x. */
  before(x: number): number {
    return lastAtOrBefore(this.x, x) + 1;
  }

  private thin(): void {
    let kept = 0;
    let length = 0;
    for (let i = 0; i < this.x.length; i += 2) {
      this.x[kept] = this.x[i];
      for (let c = 0; c < 3; c++) this.points[3 * kept + c] = this.points[3 * i + c];
      if (kept > 0) {
        length += Math.hypot(
          this.points[3 * kept] - this.points[3 * kept - 3],
          this.points[3 * kept + 1] - this.points[3 * kept - 2],
        );
      }
      kept++;
    }
    this.x.length = kept;
    this.points.length = 3 * kept;
    this.least = (0.5 * length) / kept;
  }
}

/** Something on the score curve or in the log. */
export interface Entry {
  x: number;
  time: number;
  kind: string;
  agents: number[];
  text: string;
  /** Team score after it; NaN where it changed nothing. */
  score: number;
  gain: number;
}

const CHANGES_ON_THE_CURVE = 4000;
const POINTS_OF_THE_CURVE = 4000;
const LOG_ENTRIES = 2000;
const PATH_POINTS = 1500;
const TRADES_REMEMBERED = 100_000;

export class Timeline {
  /** Whether x counts changes and offers instead of seconds: the times of a plan are milliseconds apart. */
  readonly byEvents: boolean;
  score: Series;
  flown: Series;
  entries: Entry[] = [];
  readonly paths: Path[] = [];
  /** Triples x, client, server. */
  private readonly trades: number[] = [];
  /** Triples agent, agent, how often they had traded before that. */
  private traded: Int32Array = new Int32Array(0);
  steps = 0;
  last = 0;
  /** How often all of it was replaced. */
  restored = 0;
  /** Whether vehicles were seen to fly: then committed poses are no part of their paths. */
  private flies = false;
  private readonly bounded: boolean;
  private lastScore = NaN;

  constructor(world: World, bounded: boolean) {
    this.byEvents = world.scene.run === "plan";
    this.bounded = bounded;
    this.score = new Series(bounded ? POINTS_OF_THE_CURVE : 200_000);
    this.flown = new Series(bounded ? POINTS_OF_THE_CURVE : 50_000);
    this.grow(world);
  }

  /** Agents may be added during a run. */
  grow(world: World): void {
    while (this.paths.length < world.m) this.paths.push(new Path(this.bounded ? PATH_POINTS : 20_000));
  }

  /** The place of an update on the time line; call once for each, in order. */
  place(update: Update): number {
    if (this.byEvents) {
      if (update.type === "TeamChange" || update.type === "Trading") this.steps += 1;
      return (this.last = this.steps);
    }
    return (this.last = Math.max(this.last, update.time));
  }

  /** Note an update that has been applied to `state`, at x. */
  note(x: number, update: Update, state: State): void {
    switch (update.type) {
      case "TeamState":
        this.addScore(x, teamScore(state));
        break;
      case "TeamChange": {
        const gain = update.score - this.lastScore;
        this.addScore(x, update.score);
        this.addEntry({ x, time: update.time, kind: update.kind, agents: update.agents, text: update.text, score: update.score, gain });
        if (update.kind === "trade") this.addTrade(x, update.agents[0], update.agents[1]);
        if (!this.flies) {
          for (const agent of update.posed) this.addPose(x, agent, state.poses);
        }
        break;
      }
      case "Motion":
        this.flies = true;
        if (update.score_flown !== null) this.flown.add(x, update.score_flown);
        for (let agent = 0; agent < this.paths.length; agent++) this.addPose(x, agent, state.flown ?? state.poses);
        break;
      case "Note":
      case "Ended":
      case "BoundFound":
        this.addEntry({ x, time: update.time, score: NaN, gain: NaN, ...describe(update) });
        break;
      case "Trading":
      case "Weights":
      case "Health":
      case "ObstacleAppeared": // a note says so as well
        break;
    }
  }

  /** What went before the visitor came. */
  restore(history: History): void {
    const [xs, scores] = [values(this.byEvents ? history.steps : history.times), values(history.scores)];
    this.score = new Series(POINTS_OF_THE_CURVE);
    xs.forEach((x, i) => this.score.add(x, scores[i]));
    this.lastScore = scores.length ? scores[scores.length - 1] : NaN;
    this.flown = new Series(POINTS_OF_THE_CURVE);
    const flown = values(history.scores_flown);
    values(history.times_flown).forEach((x, i) => this.flown.add(x, flown[i]));
    this.restorePaths(history);
    let before = NaN;
    this.entries = history.changes.map((change) => {
      const gain = change.score - before;
      before = change.score;
      return { ...change, x: this.byEvents ? change.step : change.time, gain };
    });
    this.traded = values(history.partners);
    this.trades.length = 0;
    this.steps = history.step;
    this.last = this.byEvents ? history.step : Math.max(this.last, xs.length ? xs[xs.length - 1] : 0);
  }

  private restorePaths(history: History): void {
    const [counts, xs, points] = [values(history.path_counts), values(history.path_x), values(history.path_points)];
    let i = 0;
    counts.forEach((count, agent) => {
      const path = new Path(PATH_POINTS);
      for (const end = i + count; i < end; i++) path.add(xs[i], points[3 * i], points[3 * i + 1], points[3 * i + 2]);
      this.paths[agent] = path;
    });
    this.restored += 1;
  }

  /** How often each agent has traded with this one up to x, most often first. */
  partners(agent: number, x: number): [number, number][] {
    const counts = new Map<number, number>();
    const count = (one: number, other: number, times: number): void => {
      const partner = one === agent ? other : other === agent ? one : -1;
      if (partner >= 0) counts.set(partner, (counts.get(partner) ?? 0) + times);
    };
    for (let i = 0; i < this.traded.length; i += 3) count(this.traded[i], this.traded[i + 1], this.traded[i + 2]);
    for (let i = 0; i < this.trades.length && this.trades[i] <= x; i += 3) count(this.trades[i + 1], this.trades[i + 2], 1);
    return [...counts].sort((a, b) => b[1] - a[1] || a[0] - b[0]);
  }

  /** Number of entries at or before x. */
  entriesUpTo(x: number): number {
    let [low, high] = [0, this.entries.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.entries[middle].x <= x) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  private addScore(x: number, score: number): void {
    if (Number.isFinite(score)) this.score.add(x, score);
    this.lastScore = score;
  }

  private addEntry(entry: Entry): void {
    this.entries.push(entry);
    if (this.bounded && this.entries.length > CHANGES_ON_THE_CURVE) this.entries.splice(0, LOG_ENTRIES);
  }

  private addTrade(x: number, client: number, server: number): void {
    if (client === undefined || server === undefined || client === NOBODY || server === NOBODY) return;
    this.trades.push(x, client, server);
    if (this.bounded && this.trades.length > 3 * TRADES_REMEMBERED) this.trades.splice(0, 1.5 * TRADES_REMEMBERED);
  }

  private addPose(x: number, agent: number, poses: Float64Array): void {
    const k = agent * POSE;
    if (Number.isFinite(poses[k])) this.paths[agent].add(x, poses[k], poses[k + 1], poses[k + 2]);
  }
}

function describe(update: Update): { kind: string; agents: number[]; text: string } {
  switch (update.type) {
    case "Note":
      return { kind: update.kind, agents: update.agents, text: update.text };
    case "Ended": {
      const proof = update.holds === null ? "" : update.holds ? "; the certificate holds" : "; the certificate does not hold";
      return { kind: "ended", agents: [], text: `${update.status}${proof}` };
    }
    case "BoundFound":
      return { kind: "bound", agents: [], text: `no deployment scores more than ${(update.bound ?? NaN).toFixed(2)}` };
    default:
      return { kind: update.type, agents: [], text: "" };
  }
}

/** Index of the last of ascending values that is at most x; -1 for none. */
export function lastAtOrBefore(ascending: ArrayLike<number>, x: number): number {
  let [low, high] = [0, ascending.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (ascending[middle] <= x) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}
